"""Cells and layouts of the tables."""

import io

import msgspec
import pytest
from rich.console import Console

from skystack.evaluation.statistics import Estimate
from skystack.reporting.results import (
    Bound,
    Comparison,
    Difference,
    RowName,
    Statistics,
    in_order,
)
from skystack.reporting.tables import (
    NOTHING,
    Table,
    by_seed,
    comparison,
    comparison_of,
    comparisons,
    duration,
    estimates,
    platforms,
    platforms_of,
    seeds_side_by_side,
    trainings,
)
from tests.reporting.rows import results, row, training


def test_a_row_beside_the_paper():
    table = comparison([row()])
    assert dict(zip(table.header, table.rows[0], strict=True)) == {
        "row": "damped and stacked",
        "paper": "7.2 ± 3.5",
        "clearances": "7.2 ± 3.5",
        "instructions": "14.5",
        "success": "98.8 %",
        "correct exit": "100.0 %",
        "excursion": "1.2 %",
        "few clearances": "\N{EN DASH}",
        "losses of separation": "2 of 3000",
        "seeds": "3",
    }


def test_rows_fresh_from_evaluation():
    rows = [row(), row(stacking=False), row(experiment="lateral-undamped")]
    fresh = [msgspec.to_builtins(one) | {"greedy": True} for one in rows]
    assert comparison_of(fresh) == comparison([rows[2], rows[1], rows[0]])


def test_the_bound_is_the_last_line():
    table = comparison([row(paper=None)], Bound(1.62, 100))
    assert table.rows[0][1] == "\N{EN DASH}"
    assert table.rows[-1][:3] == ("fewest possible", "\N{EN DASH}", "1.6")
    assert len(table.rows[-1]) == len(table.header)


def test_seeds_have_lines_of_their_own():
    several = [row(seed=seed, seeds=1) for seed in (0, 1, None)]
    table = by_seed(results(rows_by_seed=several))
    assert [cells[:2] for cells in table.rows] == [
        ("damped and stacked", "0"),
        ("damped and stacked", "1"),
        ("damped and stacked", NOTHING),
    ]


def test_seeds_stand_side_by_side_in_the_order_of_their_numbers():
    """A row's own, and only those: not of other ways, nor of the same way in another order."""
    several = [
        row(seed=10, clearances_mean=7.0, success_rate=0.9),
        row(seed=2, clearances_mean=8.0, success_rate=0.8),
        row(seed=2, stacking=False, clearances_mean=14.0, success_rate=0.7),
        row(seed=3, experiment="vertical", clearances_mean=1.0, success_rate=1.0),
        row(seed=None, experiment="do-nothing", stacking=False, clearances_mean=0.0),
    ]
    table = seeds_side_by_side(
        results(rows_by_seed=several), [row(), row(stacking=False), row(experiment="vertical")]
    )
    assert table.header == ("clearances, success", "seed 2", "seed 3", "seed 10")
    assert table.rows == (
        ("damped and stacked", "8.0, 80.0 %", NOTHING, "7.0, 90.0 %"),
        ("damped", "14.0, 70.0 %", NOTHING, NOTHING),
        ("vertical, stacked", NOTHING, "1.0, 100.0 %", NOTHING),
    )


def test_every_column_has_its_own_value():
    rates = {"success_rate": 0.1, "correct_exit_rate": 0.2, "excursion_rate": 0.3}
    counts = {"clearances_mean": 5.0, "clearances_std": None, "instructions_mean": 6.0}
    one = row(**rates, **counts, few_clearances_rate=0.4, loss_of_separation_count=7, seeds=8)
    measured = ("5.0", "6.0", "10.0 %", "20.0 %", "30.0 %", "40.0 %", "7 of 3000")
    assert comparison([one]).rows == (("damped and stacked", "7.2 ± 3.5", *measured, "8"),)
    found = by_seed(results(rows_by_seed=[one])).rows
    assert found == (("damped and stacked", NOTHING, *measured),)


def test_trainings():
    assert trainings(results(train=[training("lateral")])).rows == (
        ("lateral", "0", "2,007,040", "1 min 02 s", "32,372"),
    )


def named(table, number=0):
    """The cells of a line by the names of their columns."""
    return dict(zip(table.header, table.rows[number], strict=True))


def test_cells_stand_under_their_names():
    rates = {"success_rate": 0.1, "correct_exit_rate": 0.2, "excursion_rate": 0.3}
    counts = {"clearances_mean": 5.0, "clearances_std": None, "instructions_mean": 6.0}
    times = {"wall_s": 9.0, "same_clearances_rate": 0.5}
    one = row(seed=4, few_clearances_rate=0.4, seeds=8, **rates, **counts, **times)
    assert named(by_seed(results(rows_by_seed=[one]))) == {
        "row": "damped and stacked",
        "seed": "4",
        "clearances": "5.0",
        "instructions": "6.0",
        "success": "10.0 %",
        "correct exit": "20.0 %",
        "excursion": "30.0 %",
        "few clearances": "40.0 %",
        "losses of separation": "2 of 3000",
    }
    assert named(platforms([one])) == {
        "row": "damped and stacked",
        "paper": "7.2 ± 3.5",
        "simulator": "skystack",
        "clearances": "5.0",
        "success": "10.0 %",
        "correct exit": "20.0 %",
        "losses of separation": "2 of 3000",
        "same clearances": "50.0 %",
        "wall time": "9 s",
    }
    assert named(trainings(results(train=[training("lateral", 6)]))) == {
        "experiment": "lateral",
        "seed": "6",
        "steps": "2,007,040",
        "time": "1 min 02 s",
        "steps per second": "32,372",
    }
    assert estimates([row_with_statistics("lateral", True)]).header == (
        *("row", "clearances", "interquartile mean"),
        *("success", "interquartile mean", "losses of separation"),
    )
    assert comparisons(results()).header == (
        *("rows", "difference in clearances", "first has fewer"),
        *("difference in success, points", "first has more"),
    )
    names = RowName("lateral", True), RowName("lateral-large", False)
    gap = Difference(Estimate(1.0, 0.0, 2.0), Estimate(0.5, 0.0, 1.0))
    both = {"clearances": gap, "success": gap}
    unknown = results(rows=[row()], comparisons=[Comparison(*names, both)])
    assert comparisons(unknown).rows[0][0] == "damped and stacked against ?"


def test_rows_without_statistics_have_no_estimates():
    rows = [row(), row_with_statistics("vertical", True), row()]
    assert [line[0] for line in estimates(rows).rows] == ["vertical, stacked"]


def test_rows_of_several_simulators_fresh_from_evaluation():
    rows = [row(platform="bluesky"), row()]
    fresh = [msgspec.to_builtins(one) | {"greedy": True} for one in rows]
    assert platforms_of(fresh) == platforms([rows[1], rows[0]])


def test_markdown_is_a_table_of_its_cells():
    """The first column to the left, the others to the right."""
    table = Table(("name", "a", "second"), (("x", "1234", "5"), ("a|b", "6", "78")))
    assert table.as_markdown() == (
        "| name |    a | second |\n"
        "|------|-----:|-------:|\n"
        "| x    | 1234 |      5 |\n"
        "| a\\|b |    6 |     78 |\n"
    )


def test_markdown_is_aligned():
    lines = comparison([row(), row(stacking=False)]).as_markdown().splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1].startswith("|---")
    assert lines[1].count("-:|") == lines[0].count("|") - 2
    assert lines[3].startswith("| damped ")


def test_names_are_taken_literally():
    table = comparison([row(experiment="[red]a|b")])
    assert table.as_markdown().splitlines()[2].startswith(r"| [red]a\|b, stacked |")
    console = Console(file=io.StringIO(), width=200)
    console.print(table.as_rich())
    assert "[red]a|b, stacked" in console.file.getvalue()


def test_a_table_is_folded_only_where_it_must_be():
    """Names 4 wide, a gap of 3 behind each column: 7 + 8 + 8 are 23 characters."""
    table = Table(("name", "first", "other"), (("abcd", "11111", "22222"),))
    for width, parts in ((23, 1), (22, 2), (15, 2), (14, 2)):
        written = io.StringIO()
        Console(file=written, width=width).print(table.as_rich())
        assert written.getvalue().count("abcd") == parts, width


def test_in_the_terminal_names_are_to_the_left_and_figures_to_the_right():
    table = Table(("name", "first", "other"), (("ab", "1", "2"), ("abcdef", "12345", "67890")))
    written = io.StringIO()
    Console(file=written, width=80).print(table.as_rich())
    lines = [line.rstrip() for line in written.getvalue().splitlines()]
    assert lines[0].split() == ["name", "first", "other"]
    assert lines[2:4] == ["ab           1       2", "abcdef   12345   67890"]


def test_the_terminal_shows_every_cell():
    table = comparison([row()])
    console = Console(file=io.StringIO(), width=200)
    console.print(table.as_rich())
    shown = console.file.getvalue()
    assert all(cell in shown for cell in table.rows[0])
    assert all(word in shown for name in table.header for word in name.split())


@pytest.mark.parametrize("width", [40, 80, 100, 120, 200])
def test_a_narrow_terminal_folds_the_table_and_cuts_nothing(width):
    table = comparison([row(), row(stacking=False)])
    console = Console(file=io.StringIO(), width=width)
    console.print(table.as_rich())
    lines = console.file.getvalue().splitlines()
    assert all(len(line) <= width for line in lines)
    for name, *cells in table.rows:
        shown = [line for line in lines if line.startswith(f"{name}   ")]
        assert sum(line.count(cell) for cell in set(cells) for line in shown) >= len(set(cells))
        assert all(any(cell in line for line in shown) for cell in cells)
    headers = [line for line in lines if line.startswith("row")]
    assert (len(headers) > 1) == (width < 130)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.2, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min 00 s"),
        (185, "3 min 05 s"),
        (3599.4, "59 min 59 s"),
        (3599.9, "1 h 00 min"),
        (7080, "1 h 58 min"),
        (7500, "2 h 05 min"),
        (90_000, "25 h 00 min"),
    ],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def test_simulators_stand_together_ours_first():
    theirs = {"wall_s": 75.0, "same_clearances_rate": 0.95, "episodes": 100}
    table = platforms(
        in_order(
            [
                row(platform="bluesky", **theirs),
                row(platform="bluebird", **theirs),
                row(wall_s=4.2, episodes=100),
                row(experiment="lateral-large", platform="bluebird", **theirs),
            ]
        )
    )
    assert [line[:3] for line in table.rows] == [
        ("damped and stacked", "7.2 ± 3.5", "skystack"),
        ("damped and stacked", "7.2 ± 3.5", "BluebirdDT"),
        ("damped and stacked", "7.2 ± 3.5", "BlueSky"),
        ("37 actions, stacked", "7.2 ± 3.5", "BluebirdDT"),
    ]
    assert table.rows[0][-2:] == (NOTHING, "4 s")
    assert table.rows[1][3:] == (
        "7.2 ± 3.5",
        "98.8 %",
        "100.0 %",
        "2 of 100",
        "95.0 %",
        "1 min 15 s",
    )


def test_estimates_and_comparisons_carry_their_intervals():
    less = Difference(Estimate(-2.0, -3.0, -1.0), Estimate(0.8, 0.6, 1.0))
    lower = Difference(Estimate(-0.02, -0.03, 0.01), Estimate(0.9, 0.7, 1.0))
    names = RowName("lateral", True), RowName("lateral-large", False)
    both = results(
        rows=[row_with_statistics("lateral", True), row_with_statistics("lateral-large", False)],
        comparisons=[Comparison(*names, {"clearances": less, "success": lower})],
    )
    assert comparisons(both).rows == (
        (
            "damped and stacked against 37 actions",
            "-2.0 [-3.0, -1.0]",
            "80 % [60, 100]",
            "-2.0 [-3.0, 1.0]",
            "10 % [0, 30]",
        ),
    )
    assert estimates(both.rows).rows[0] == (
        "damped and stacked",
        "7.2 [6.9, 7.5]",
        "7.1 [7.0, 7.3]",
        "98.0 % [97.0, 99.0]",
        "99.0 % [98.0, 100.0]",
        "0.5 % [0.0, 1.0]",
    )


def row_with_statistics(experiment, stacking):
    clearances = Statistics(Estimate(7.2, 6.9, 7.5), Estimate(7.1, 7.0, 7.3))
    success = Statistics(Estimate(0.98, 0.97, 0.99), Estimate(0.99, 0.98, 1.0))
    lost = Statistics(Estimate(0.005, 0.0, 0.01), Estimate(0.0, 0.0, 0.0))
    measures = {"clearances": clearances, "success": success, "loss_of_separation": lost}
    return row(experiment=experiment, stacking=stacking, seeds=1, statistics=measures)
