"""Dependencies: what is declared, imported, explained and listed with its licence is the same."""

import ast
import re
import sys
from importlib.metadata import packages_distributions

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.docs.blocks import ROOT
from tools.licences import CORE, PAGE, needed, requirements

DECLARED = {
    extra: {canonicalize_name(Requirement(line).name) for line in lines}
    for extra, lines in requirements().items()
}


def rows(heading):
    """The cells of the table under a heading of the page."""
    page = (ROOT / "docs" / "dependencies.md").read_text()
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    lines = [line for line in section.splitlines() if line.startswith("| `")]
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines]


def imported():
    """Top-level modules of others that the package imports, anywhere in a file."""
    found = set()
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"skystack"}


def test_every_dependency_is_explained():
    assert {canonicalize_name(name) for name, why in rows("The core") if why} == DECLARED[CORE]
    explained = {(extra, canonicalize_name(name)) for extra, name, why in rows("The extras") if why}
    assert explained == {
        (extra, name) for extra, names in DECLARED.items() if extra != CORE for name in names
    }


def distributions(module, of_module):
    """What a module comes from here, by canonical names; nothing where it is not installed."""
    return {canonicalize_name(name) for name in of_module.get(module, ())}


def test_every_import_is_declared_and_the_core_is_imported():
    of_module, declared = packages_distributions(), set().union(*DECLARED.values())
    found = {module: distributions(module, of_module) for module in imported()}
    undeclared = {module for module, names in found.items() if not names & declared}
    assert undeclared == {module for module, _ in rows("Used if installed")}
    assert DECLARED[CORE] <= set().union(*found.values())


@pytest.mark.parametrize("extra", DECLARED)
def test_the_licence_of_all_that_is_installed_is_listed(extra):
    found, _ = needed(requirements()[extra])
    listed = re.findall(r"^\| ([\w.-]+) \| \S+ \| [^ ]", PAGE.read_text(), re.MULTILINE)
    assert set(found) <= set(listed)
    if extra == CORE:
        assert {"jaxlib", "numpy"} <= set(found)  # what dependencies need as well


def test_copyleft_in_the_core_is_what_the_page_says():
    core, extras = PAGE.read_text().split("## The core\n")[1].split("## `[", 1)
    marked = r"^\| ([\w-]+) \| \S+ \| \*\*"
    assert re.findall(marked, core, re.MULTILINE) == ["certifi"]
    assert {"bluebird-dt", "pebble"} <= set(re.findall(marked, extras, re.MULTILINE))
