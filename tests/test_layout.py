"""Packages import only packages below them, and no modules form a cycle."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import skystack

SOURCE = Path(skystack.__file__).parent
LAYERS = (
    "errors",
    "stacking",
    "io",
    "compilation",
    "airspace",
    "simulator",
    "platforms",
    "tasks",
    "learning",
    "policies",
    "agents",
    "evaluation",
    "reporting",
    "reproduction",
    "export",
    "gym",
    "benchmarking",
    "live",
    "cli",
    "__main__",
)
"""From the lowest to the highest. `stacking` and `errors` have no dependencies."""


def module_of(path):
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


MODULES = {module_of(path): path for path in SOURCE.rglob("*.py")}


def imported(path):
    """The skystack modules that a file imports at run time, including inside functions."""
    found = set()
    for node in nodes(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.removeprefix("skystack.") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = node.module.removeprefix("skystack").removeprefix(".")
            inner = [f"{package}.{alias.name}".removeprefix(".") for alias in node.names]
            found |= {name if name in MODULES else package for name in inner}
    return found & MODULES.keys() - {""}


def nodes(tree):
    """All nodes of a syntax tree, except under `if TYPE_CHECKING`."""
    pending = [tree]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        pending += ast.iter_child_nodes(node)


def layer(module):
    return LAYERS.index(module.partition(".")[0])


def test_every_module_has_a_layer():
    assert {module.partition(".")[0] for module in MODULES} - {""} == set(LAYERS)


def test_imports_point_downwards():
    upward = [
        f"{module} imports {other}"
        for module, path in MODULES.items()
        if module != ""
        for other in imported(path)
        if layer(other) > layer(module)
    ]
    assert upward == []


def test_top_level_package_imports_no_submodule():
    assert imported(MODULES[""]) == set()


def test_modules_form_no_cycle():
    graph = {module: imported(path) - {module} for module, path in MODULES.items() if module}
    TopologicalSorter(graph).prepare()


def test_class_names_are_unique():
    names = [
        node.name
        for path in MODULES.values()
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef)
    ]
    assert sorted(set(names)) == sorted(names)
