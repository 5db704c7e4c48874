"""Mutations: our own small changes to a source, and the lists of modules and tests."""

import re

import pytest

from tests.docs.blocks import ROOT
from verification.mutation import parts
from verification.mutation.mutants import change, own_places, statement_lines

SOURCE = ROOT / "src" / "skystack"


def changes(source):
    return sorted(
        (place.operator, change(source, place.changed()).after) for place in own_places(source)
    )


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("f(a, b)", [("Exchange", "f(b, a)")]),
        ("f(a, a)", []),
        ("f(a, *b)", []),
        ('f(a, "b", 1)', [("Exchange", 'f("b", a, 1)')]),
        ("maximum(a, b)", [("DropWrapper", "a")]),
        ("jnp.where(a, b, 0)", [("Exchange", "jnp.where(a, 0, b)")]),
        ("x = a, b", [("Exchange", "x = b, a")]),
        ("a, b = x", [("Exchange", "b, a = x")]),
        ("a + 1 if c else b", [("Exchange", "b if c else (a + 1)")]),
        ("f(a, b=1)", [("DropKeyword", "f(a)")]),
        ("f(a=1, b=2)", [("DropKeyword", "f(a=1)"), ("DropKeyword", "f(b=2)")]),
        ("f(a=1)", []),
        ("x[:, 0]", []),
        ("x: dict[a, b] = y", []),
        ("clip(a - b, 0)", [("DropWrapper", "(a - b)"), ("Exchange", "clip(0, (a - b))")]),
        ("é(ü, b)", [("Exchange", "é(b, ü)")]),
    ],
)
def test_finds_our_own_changes(source, expected):
    assert changes(source) == expected


def test_arguments_of_different_types_are_not_exchanged():
    assert changes("def f(a: int, b: str, c: int):\n    return g(a, b, c)") == []
    assert changes("def f(a: int, c: int):\n    return g(a, c)") == [("Exchange", "return g(c, a)")]


def test_a_change_has_the_lines_that_differ():
    assert change("a\n  b\nc", "a\n  d\nc") == (2, "b", "d")
    assert change("a\nb\nc", "a\nc") == (2, "b", "")
    assert change("f(\n  a,\n  b,\n)", "f(\n  b,\n  a,\n)") == (2, "a, b,", "b, a,")
    assert change("a\na", "a\na\na") == (3, "", "a")


def test_a_line_belongs_to_its_innermost_statement():
    source = "x = f(\n    a,\n)\nif (\n    y\n):\n    z = 1\n    for w in v:\n        u = w\n"
    lines = [list(statement_lines(source, line)) for line in range(1, 10)]
    first, condition = [1, 2, 3], [4, 5, 6]
    assert lines == [first] * 3 + [condition] * 3 + [[7], [8], [9]]


def test_every_listed_module_and_test_exists():
    listed = {SOURCE / name for name in (*parts.TESTS, *parts.IN_PROCESSES)}
    listed |= {
        SOURCE / name for package in parts.PRELOADED for name in parts.modules(ROOT, package)
    }
    listed |= {ROOT / test for tests in parts.TESTS.values() for test in tests}
    assert {str(path) for path in listed if not path.exists()} == set()


def test_every_excluded_test_exists():
    tests = "".join(path.read_text() for path in ROOT.glob("tests/**/test_*.py"))
    names = re.findall(r"def (test_\w+)", tests)
    assert [part for part in parts.LEFT_OUT if not any(part in name for name in names)] == []


@pytest.mark.parametrize("package", parts.PRELOADED)
def test_equivalent_changes_quote_the_current_code(package):
    for module, before, after in parts.equivalent(package):
        lines = (SOURCE / module).read_text().splitlines()
        assert before in " ".join(line.strip() for line in lines), (module, before)
        assert before != after
