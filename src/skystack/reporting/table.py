"""Tables of texts, shown in the terminal, in Markdown and on pages."""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import rich.box
import rich.table
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, JustifyMethod
from rich.text import Text

from skystack.errors import printable


class Table(NamedTuple):
    """Cells of arbitrary text. The first column contains names, the others numbers."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def as_markdown(self) -> str:
        """A Markdown table, columns padded to equal width."""
        lines = [tuple(map(plain_markdown, line)) for line in (self.header, *self.rows)]
        widths = [max(len(line[column]) for line in lines) for column in range(len(self.header))]

        def line(cells: tuple[str, ...]) -> str:
            first = cells[0].ljust(widths[0])
            others = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
            return f"| {' | '.join([first, *others])} |"

        rule = "|".join(["-" * (widths[0] + 2), *("-" * (width + 1) + ":" for width in widths[1:])])
        return "\n".join([line(self.header), f"|{rule}|", *(line(row) for row in lines[1:])]) + "\n"

    def as_rich(self) -> "ForTerminal":
        """A table for the terminal."""
        return ForTerminal(self)


class ForTerminal:
    """A table that is split into several, one below the other, in a narrow terminal."""

    def __init__(self, table: Table) -> None:
        self._lines = [tuple(map(printable, line)) for line in (table.header, *table.rows)]

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> Iterator[rich.table.Table | str]:
        """One table, or several that each start with the column of names."""
        names, *others = zip(*self._lines, strict=True)
        for part in _parts(others, options.max_width - _width(names)):
            table = rich.table.Table(box=rich.box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
            for column in (names, *part):
                justify: JustifyMethod = "left" if column is names else "right"
                table.add_column(Text(column[0]), justify=justify, width=_width(column) - GAP)
            for cells in zip(*(column[1:] for column in (names, *part)), strict=True):
                table.add_row(*map(Text, cells))
            yield table
            yield ""


def _parts(columns: Sequence[tuple[str, ...]], width: int) -> list[list[tuple[str, ...]]]:
    """Group the columns to fit the width; a column that is too wide has its own group."""
    parts: list[list[tuple[str, ...]]] = []
    free = 0
    for column in columns:
        if not parts or _width(column) > free:
            parts.append([])
            free = width
        parts[-1].append(column)
        free -= _width(column)
    return parts


GAP = 3
"""The number of characters between two columns in the terminal."""


def _width(column: tuple[str, ...]) -> int:
    """The width of a column in the terminal. Headers wrap between words, cells do not wrap."""
    return max(map(cell_len, (*column[0].split(), *column[1:]))) + GAP


def plain_markdown(text: str) -> str:
    """Escape a text so that Markdown shows it literally, without cells, links, code or HTML."""
    text = re.sub(r"([\\|`<])", r"\\\1", printable(text))
    return text.replace("](", "]\\(")
