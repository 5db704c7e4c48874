"""Small changes to a module's source, each of which some test should detect.

Most are made by cosmic-ray: another operator, another number, a negated condition. The others are
our own, for mistakes that reviews have found: exchanged arguments, elements or branches, a dropped
call such as `clip`, a dropped keyword argument.
"""

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

ARITHMETIC, BITS = "Add|Sub|Mul|Div|FloorDiv|Mod|Pow", "BitAnd|BitOr|BitXor|LShift|RShift"
POINTLESS = re.compile(
    rf"Binary\w+_({ARITHMETIC})_({BITS}|FloorDiv|Mod|Pow)|Binary\w+_({BITS})_({ARITHMETIC}|.Shift)"
    r"|Comparison\w+_Is(Not)?$"
)
"""Operators that only cause type errors here (bits of floats, sums of truth values, identity), or
that test nothing beyond another one."""

_NAMES = (
    "abs ceil clip dict exp floor frozenset list log max maximum min minimum round set sorted sqrt"
    " stop_gradient sum tuple unique wrap_180 wrap_360"
)
WRAPPERS = frozenset(_NAMES.split())
"""Functions whose call is replaced by its first argument."""
COMMUTATIVE = frozenset(
    ["array_equal", "dot", "hypot", "isclose", "max", "maximum", "min", "minimum"]
)
"""Functions whose arguments are not exchanged."""


class Place(NamedTuple):
    """A possible change of a source; the changed source is made on demand."""

    line: int
    operator: str
    changed: Callable[[], str]


class Change(NamedTuple):
    """The lines that a change affects, joined and without their indentation."""

    line: int
    before: str
    after: str


def places(source: str) -> list[Place]:
    """All changes, of every operator at every place, in the order of lines."""
    found = sorted((*_by_cosmic_ray(source), *own_places(source)), key=lambda place: place.line)
    annotated = _annotation_lines(source)
    return [place for place in found if place.line not in annotated]


def change(before: str, after: str) -> Change:
    """The lines in which two sources differ."""
    old, new = before.splitlines(), after.splitlines()
    start = 0
    while start < min(len(old), len(new)) and old[start] == new[start]:
        start += 1
    end = 0
    while end < min(len(old), len(new)) - start and old[-1 - end] == new[-1 - end]:
        end += 1
    cut = (lines[start : len(lines) - end] for lines in (old, new))
    return Change(start + 1, *(" ".join(line.strip() for line in lines) for lines in cut))


def statement_lines(source: str, line: int) -> range:
    """The lines of the innermost statement that contains a line, without the statement's body."""
    best = range(line, line + 1)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or line):
            body = getattr(node, "body", None)
            end = body[0].lineno if body else (node.end_lineno or line) + 1
            if line < end or not body:
                best = range(node.lineno, end)  # inner statements come later in the walk
    return best


def _by_cosmic_ray(source: str) -> Iterator[Place]:
    from cosmic_ray.ast import ast_nodes, get_ast  # noqa: PLC0415  (an extra)
    from cosmic_ray.mutating import mutate_code  # noqa: PLC0415
    from cosmic_ray.plugins import get_operator, operator_names  # noqa: PLC0415

    nodes = list(ast_nodes(get_ast(source)))
    for name in operator_names():
        operator = get_operator(name)
        if operator.arguments() or POINTLESS.search(name):
            continue
        starts = [start for node in nodes for start, _ in operator().mutation_positions(node)]
        for number, (line, _) in enumerate(starts):

            def changed(made: Callable[..., object] = operator, number: int = number) -> str:
                result = mutate_code(source, made(), number)
                assert isinstance(result, str)
                return result

            yield Place(line, name.removeprefix("core/"), changed)


def own_places(source: str) -> Iterator[Place]:
    """The changes of our own operators, in no particular order."""
    text, tree = _Text(source), ast.parse(source)
    types, typed = _types(tree)
    for node in ast.walk(tree):
        if node in types:
            continue
        if isinstance(node, ast.Call):
            if _name(node.func) in WRAPPERS and node.args:
                yield text.place("DropWrapper", node, [(node, node.args[0])])
            for keyword in node.keywords if len(node.keywords) + len(node.args) > 1 else ():
                yield text.dropped_keyword(keyword)
        for one, other in _neighbours(node):
            if _alike(one, other, typed):
                yield text.place("Exchange", one, [(one, other), (other, one)])


def _neighbours(node: ast.AST) -> Iterable[tuple[ast.expr, ast.expr]]:
    """The pairs of expressions in a node whose exchange may change the meaning."""
    if isinstance(node, ast.Call) and _name(node.func) not in COMMUTATIVE:
        return pairwise(node.args[1:] if _name(node.func) == "where" else node.args)
    if isinstance(node, ast.Tuple):
        return pairwise(node.elts)
    return [(node.body, node.orelse)] if isinstance(node, ast.IfExp) else []


def _types(tree: ast.AST) -> tuple[set[ast.AST], dict[str, str]]:
    """The nodes inside annotations, and the annotation of each parameter."""
    types: set[ast.AST] = set()
    typed: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.arg) and node.annotation is not None:
            typed[node.arg] = ast.dump(node.annotation)
        for name in ("annotation", "returns"):
            annotation = getattr(node, name, None)
            types.update(ast.walk(annotation) if annotation is not None else ())
    return types, typed


def _alike(one: ast.expr, other: ast.expr, typed: dict[str, str]) -> bool:
    """Whether two expressions differ and may have the same type, so that an exchange is useful."""
    kinds = []
    for each in (one, other):
        if isinstance(each, ast.Starred | ast.Slice):
            return False
        literal = isinstance(each, ast.Constant) and type(each.value)
        kinds.append(typed.get(each.id) if isinstance(each, ast.Name) else literal or None)
    known = None not in kinds
    return ast.dump(one) != ast.dump(other) and not (known and kinds[0] != kinds[1])


class _Text:
    """A source whose nodes can be replaced by other nodes."""

    def __init__(self, source: str) -> None:
        self._bytes = source.encode()
        lengths = [len(line) for line in self._bytes.splitlines(keepends=True)]
        self._starts = [sum(lengths[:number]) for number in range(len(lengths))]

    def place(
        self, operator: str, node: ast.expr, replaced: list[tuple[ast.expr, ast.expr]]
    ) -> Place:
        parts = [(self._span(old), self._of(new)) for old, new in replaced]
        return Place(node.lineno, operator, lambda: self._with(parts))

    def dropped_keyword(self, keyword: ast.keyword) -> Place:
        start, end = self._span(keyword)
        after = re.match(rb"\s*,\s*", self._bytes[end:])
        before = re.search(rb",\s*$", self._bytes[:start])
        if after:
            end += after.end()
        elif before:
            start = before.start()
        return Place(keyword.lineno, "DropKeyword", lambda: self._with([((start, end), b"")]))

    def _span(self, node: ast.expr | ast.keyword) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = self._starts[node.lineno - 1] + node.col_offset
        return start, self._starts[node.end_lineno - 1] + node.end_col_offset

    def _of(self, node: ast.expr) -> bytes:
        start, end = self._span(node)
        compound = isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare | ast.IfExp | ast.UnaryOp)
        text = self._bytes[start:end]
        return b"(" + text + b")" if compound else text

    def _with(self, parts: list[tuple[tuple[int, int], bytes]]) -> str:
        result = self._bytes
        for (start, end), new in sorted(parts, reverse=True):
            result = result[:start] + new + result[end:]
        return result.decode()


def _name(function: ast.expr) -> str:
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def _annotation_lines(source: str) -> set[int]:
    """Lines with nothing but types, where a change fails at import or has no effect."""
    lines: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.AnnAssign) and node.value is None:
            lines.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        if isinstance(node, ast.FunctionDef):
            defaults = {
                number
                for default in (*node.args.defaults, *node.args.kw_defaults)
                if default is not None
                for number in range(default.lineno, (default.end_lineno or default.lineno) + 1)
            }
            lines.update(set(range(node.lineno, node.body[0].lineno)) - defaults)
    return lines
