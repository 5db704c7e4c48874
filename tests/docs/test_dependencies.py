"""Every dependency is declared, imported_modules, explained and listed with its licence."""

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
    """The cells of the table under a heading of docs/dependencies.md."""
    page = (ROOT / "docs" / "dependencies.md").read_text()
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    lines = [line for line in section.splitlines() if line.startswith("| `")]
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines]


def imported_modules():
    """The top-level third-party modules that the package imports anywhere."""
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
    """The canonical names of a module's distributions; empty if it is not installed."""
    return {canonicalize_name(name) for name in of_module.get(module, ())}


def test_imports_match_the_declared_dependencies():
    of_module, declared = packages_distributions(), set().union(*DECLARED.values())
    found = {module: distributions(module, of_module) for module in imported_modules()}
    undeclared = {module for module, names in found.items() if not names & declared}
    assert undeclared == {module for module, _ in rows("Used if installed")}
    assert DECLARED[CORE] <= set().union(*found.values())


@pytest.mark.parametrize("extra", DECLARED)
def test_lists_the_licences_of_all_installed_packages(extra):
    found, _ = needed(requirements()[extra])
    listed = re.findall(r"^\| ([\w.-]+) \| \S+ \| [^ ]", PAGE.read_text(), re.MULTILINE)
    assert set(found) <= set(listed)
    if extra == CORE:
        assert {"jaxlib", "numpy"} <= set(found)  # indirect dependencies


def test_licence_page_marks_copyleft_packages():
    core, extras = PAGE.read_text().split("## The core\n")[1].split("## `[", 1)
    marked = r"^\| ([\w-]+) \| \S+ \| \*\*"
    assert re.findall(marked, core, re.MULTILINE) == ["certifi"]
    assert {"bluebird-dt", "pebble"} <= set(re.findall(marked, extras, re.MULTILINE))
