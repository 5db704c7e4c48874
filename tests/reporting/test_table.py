"""Tables of texts: their layout in the terminal and in Markdown."""

import io

import pytest
from rich.console import Console

from skystack.reporting.table import Table
from skystack.reporting.tables import comparison
from tests.reporting.rows import row


def test_markdown_aligns_names_left_and_numbers_right():
    table = Table(("name", "a", "second"), (("x", "1234", "5"), ("a|b", "6", "78")))
    assert table.as_markdown() == (
        "| name |    a | second |\n"
        "|------|-----:|-------:|\n"
        "| x    | 1234 |      5 |\n"
        "| a\\|b |    6 |     78 |\n"
    )


def test_markdown_lines_have_equal_width():
    lines = comparison([row(), row(stacking=False)]).as_markdown().splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1].startswith("|---")
    assert lines[1].count("-:|") == lines[0].count("|") - 2
    assert lines[3].startswith("| damped ")


def test_names_are_not_interpreted_as_markup():
    table = comparison([row(experiment="[red]a|b")])
    assert table.as_markdown().splitlines()[2].startswith(r"| [red]a\|b, stacked |")
    console = Console(file=io.StringIO(), width=200)
    console.print(table.as_rich())
    assert "[red]a|b, stacked" in console.file.getvalue()


def test_table_is_folded_only_if_it_is_too_wide():
    """Columns of 4, 5 and 5 characters, each with a gap of 3: 7 + 8 + 8 = 23."""
    table = Table(("name", "first", "other"), (("abcd", "11111", "22222"),))
    for width, parts in ((23, 1), (22, 2), (15, 2), (14, 2)):
        output = io.StringIO()
        Console(file=output, width=width).print(table.as_rich())
        assert output.getvalue().count("abcd") == parts, width


def test_terminal_aligns_names_left_and_numbers_right():
    table = Table(("name", "first", "other"), (("ab", "1", "2"), ("abcdef", "12345", "67890")))
    output = io.StringIO()
    Console(file=output, width=80).print(table.as_rich())
    lines = [line.rstrip() for line in output.getvalue().splitlines()]
    assert lines[0].split() == ["name", "first", "other"]
    assert lines[2:4] == ["ab           1       2", "abcdef   12345   67890"]


def test_terminal_shows_every_cell():
    table = comparison([row()])
    console = Console(file=io.StringIO(), width=200)
    console.print(table.as_rich())
    printed = console.file.getvalue()
    assert all(cell in printed for cell in table.rows[0])
    assert all(word in printed for name in table.header for word in name.split())


@pytest.mark.parametrize("width", [40, 80, 100, 120, 200])
def test_narrow_terminal_folds_the_table_and_keeps_all_cells(width):
    table = comparison([row(), row(stacking=False)])
    console = Console(file=io.StringIO(), width=width)
    console.print(table.as_rich())
    lines = console.file.getvalue().splitlines()
    assert all(len(line) <= width for line in lines)
    for name, *cells in table.rows:
        printed = [line for line in lines if line.startswith(f"{name}   ")]
        assert sum(line.count(cell) for cell in set(cells) for line in printed) >= len(set(cells))
        assert all(any(cell in line for line in printed) for cell in cells)
    headers = [line for line in lines if line.startswith("row")]
    assert (len(headers) > 1) == (width < 130)
