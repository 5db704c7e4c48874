"""The cells and layouts of tables."""

import io

import msgspec
import pytest
from rich.console import Console

from skystack.evaluation.estimate import Estimate
from skystack.reporting.results import (
    READABLE_NAMES,
    Bound,
    Comparison,
    Difference,
    Paper,
    RowName,
    Statistics,
    in_order,
)
from skystack.reporting.table import Table
from skystack.reporting.tables import (
    NOTHING,
    brief,
    by_seed,
    comparison,
    comparisons,
    duration,
    estimates,
    interval,
    one_row,
    percent_interval,
    platforms,
    sampled,
    seeds_side_by_side,
    trainings,
)
from tests.reporting.rows import results, row, training


def test_comparison_with_the_paper():
    table = comparison([row(exit_offset_nm_mean=2.34)])
    assert dict(zip(table.header, table.rows[0], strict=True)) == {
        "row": "damped and stacked",
        "paper": "7.2 ± 3.5",
        "clearances": "7.2 ± 3.5",
        "instructions": "14.5",
        "success": "98.8 %",
        "correct exit": "100.0 %",
        "excursion": "1.2 %",
        "few clearances": "\N{EN DASH}",
        "exit offset, NM": "2.3",
        "losses of separation": "2 of 3000",
        "seeds": "3",
    }


def test_comparison_hides_the_counts_of_untrained_policies():
    """Their rates remain. Doing nothing is never called untrained."""
    trained, untrained = row(), row(stacking=False, exit_offset_nm_mean=1.5)
    idle = row(experiment="do-nothing-lateral", stacking=False, clearances_mean=0.0)
    table = comparison([trained, untrained, idle], is_trained=lambda one: one is trained)
    assert table.rows[0] == comparison([trained]).rows[0]
    assert table.rows[2] == comparison([idle]).rows[0]
    assert cells_by_name(table, 1) == {
        "row": "damped",
        "paper": "7.2 ± 3.5",
        "clearances": "not trained",
        "instructions": NOTHING,
        "success": "98.8 %",
        "correct exit": "100.0 %",
        "excursion": "1.2 %",
        "few clearances": NOTHING,
        "exit offset, NM": "1.5",
        "losses of separation": "2 of 3000",
        "seeds": "3",
    }


def test_brief_table_has_the_main_figures():
    one, other = row(exit_offset_nm_mean=2.34), row(experiment="mine", task="lateral", paper=None)
    table = brief([one, other], Bound(1.62, 100))
    assert table.header == ("row", "paper", "clearances", "success", "exit offset, NM")
    assert table.rows == (
        ("damped and stacked", "7.2 ± 3.5", "7.2 ± 3.5", "98.8 %", "2.3"),
        ("mine, stacked", NOTHING, "7.2 ± 3.5", "98.8 %", NOTHING),
        ("fewest possible", NOTHING, "1.6", NOTHING, NOTHING),
    )


def test_brief_table_omits_the_paper_if_it_has_no_value():
    table = brief([row(paper=None), row(paper=None, stacking=False)], Bound(1.62, 100))
    assert table.header == ("row", "clearances", "success", "exit offset, NM")
    assert table.rows[-1] == ("fewest possible", "1.6", NOTHING, NOTHING)


def test_brief_table_shows_lost_separation_for_avoidance_only():
    """As the share of scenarios; names do not repeat the family."""
    figures = {"task": "avoidance", "paper": None}
    rows = [
        row(experiment="avoidance", stacking=False, **figures, loss_of_separation_count=75),
        row(experiment="avoidance", **figures, loss_of_separation_count=0),
        row(experiment="avoidance-best", **figures, loss_of_separation_count=0, episodes=0),
        row(experiment="do-nothing-avoidance", stacking=False, **figures),
    ]
    table = brief(rows)
    assert table.header == ("row", "clearances", "success", "exit offset, NM", "loss rate")
    assert [(line[0], line[-1]) for line in table.rows] == [
        ("avoidance", "2.5 %"),
        ("stacked", "0.0 %"),
        ("ours, stacked", "0.0 %"),
        ("do nothing", "0.1 %"),
    ]
    vertical = brief([row(experiment="vertical", **figures | {"task": "vertical"})])
    assert vertical.header == ("row", "clearances", "success", "exit offset, NM")
    assert vertical.rows[0][0] == "stacked"


def test_brief_table_hides_the_counts_of_untrained_policies():
    idle = row(experiment="do-nothing-lateral", stacking=False)
    table = brief([row(), idle], is_trained=lambda one: False)
    assert [cells_by_name(table, number)["clearances"] for number in (0, 1)] == [
        "not trained",
        "7.2 ± 3.5",
    ]
    assert cells_by_name(table)["success"] == "98.8 %"


@pytest.mark.parametrize("family", ["lateral", "vertical", "avoidance"])
def test_brief_tables_fit_80_columns(family):
    """With the longest names, and counts as large as the paper's."""
    figures = {"paper": Paper(126.3, 12.3), "clearances_mean": 126.3, "clearances_std": 12.3}
    figures |= {"success_rate": 1.0, "exit_offset_nm_mean": 10.0, "task": family}
    rows = [
        row(experiment=name, stacking=way, **figures)
        for name, way in READABLE_NAMES
        if family in name
    ]
    console = Console(file=io.StringIO(), width=80)
    console.print(brief(rows, Bound(1.6, 1)).as_rich())
    headers = [line for line in console.file.getvalue().splitlines() if line.startswith("row")]
    assert len(headers) == 1


def test_sampled_actions_are_beside_the_most_probable_ones():
    sampled_row = row(clearances_mean=16.0, clearances_std=5.0, success_rate=0.5)
    alone = row(experiment="lateral-large", stacking=False)  # as in a file made by hand
    table = sampled(results(rows=[row()], sampled=[sampled_row, alone]))
    assert cells_by_name(table) == {
        "row": "damped and stacked",
        "paper": "7.2 ± 3.5",
        "clearances": "7.2 ± 3.5",
        "clearances, sampled": "16.0 ± 5.0",
        "success": "98.8 %",
        "success, sampled": "50.0 %",
        "loss rate": "0.1 %",
        "loss rate, sampled": "0.1 %",
    }
    cells = cells_by_name(table, 1)
    assert (cells["clearances"], cells["clearances, sampled"]) == (NOTHING, "7.2 ± 3.5")


def test_one_row_of_an_evaluation_has_one_line_per_measure():
    fresh = msgspec.to_builtins(row(exit_offset_nm_mean=2.34, few_clearances_rate=0.5))
    table = one_row(fresh | {"greedy": True, "metrics": {"more": 1.0}})
    assert table.header == ("measure", "value")
    assert table.rows == (
        ("clearances per scenario", "7.2 ± 3.5"),
        ("clearances in the paper", "7.2 ± 3.5"),
        ("instructions per scenario", "14.5"),
        ("success", "98.8 %"),
        ("correct exit", "100.0 %"),
        ("excursion", "1.2 %"),
        ("few clearances", "50.0 %"),
        ("exit offset, NM", "2.3"),
        ("scenarios with a loss of separation", "2 of 3000"),
    )


def test_one_row_shows_only_known_values():
    """No line for the paper without its value; a dash where nothing could be measured."""
    table = one_row(msgspec.to_builtins(row(paper=None, instructions_mean=None)))
    lines = dict(table.rows)
    assert "clearances in the paper" not in lines
    assert lines["exit offset, NM"] == lines["instructions per scenario"] == NOTHING
    assert lines["few clearances"] == NOTHING


def test_bound_is_the_last_line():
    table = comparison([row(paper=None)], Bound(1.62, 100))
    assert table.rows[0][1] == "\N{EN DASH}"
    assert table.rows[-1][:3] == ("fewest possible", "\N{EN DASH}", "1.6")
    assert len(table.rows[-1]) == len(table.header)


def test_each_seed_has_its_own_line():
    several = [row(seed=seed, seeds=1) for seed in (0, 1, None)]
    table = by_seed(results(rows_by_seed=several))
    assert [cells[:2] for cells in table.rows] == [
        ("damped and stacked", "0"),
        ("damped and stacked", "1"),
        ("damped and stacked", NOTHING),
    ]


def test_seeds_are_side_by_side_in_numerical_order():
    """Each line contains only the seeds of its own row."""
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


def test_each_column_shows_its_own_value():
    rates = {"success_rate": 0.1, "correct_exit_rate": 0.2, "excursion_rate": 0.3}
    counts = {"clearances_mean": 5.0, "clearances_std": None, "instructions_mean": 6.0}
    others = {"few_clearances_rate": 0.4, "exit_offset_nm_mean": 9.0}
    one = row(**rates, **counts, **others, loss_of_separation_count=7, seeds=8)
    measured = ("5.0", "6.0", "10.0 %", "20.0 %", "30.0 %", "40.0 %", "9.0", "7 of 3000")
    assert comparison([one]).rows == (("damped and stacked", "7.2 ± 3.5", *measured, "8"),)
    found = by_seed(results(rows_by_seed=[one])).rows
    assert found == (("damped and stacked", NOTHING, *measured),)


def test_trainings_table():
    assert trainings(results(train=[training("lateral")])).rows == (
        ("lateral", "0", "2,007,040", "1 min 02 s", "32,372"),
    )


def cells_by_name(table, number=0):
    """The cells of a line by column name."""
    return dict(zip(table.header, table.rows[number], strict=True))


def test_cells_are_in_the_columns_of_their_names():
    rates = {"success_rate": 0.1, "correct_exit_rate": 0.2, "excursion_rate": 0.3}
    counts = {"clearances_mean": 5.0, "clearances_std": None, "instructions_mean": 6.0}
    times = {"wall_s": 9.0, "same_clearances_rate": 0.5, "exit_offset_nm_mean": 9.0}
    one = row(seed=4, few_clearances_rate=0.4, seeds=8, **rates, **counts, **times)
    assert cells_by_name(by_seed(results(rows_by_seed=[one]))) == {
        "row": "damped and stacked",
        "seed": "4",
        "clearances": "5.0",
        "instructions": "6.0",
        "success": "10.0 %",
        "correct exit": "20.0 %",
        "excursion": "30.0 %",
        "few clearances": "40.0 %",
        "exit offset, NM": "9.0",
        "losses of separation": "2 of 3000",
    }
    assert cells_by_name(platforms([one])) == {
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
    assert cells_by_name(trainings(results(train=[training("lateral", 6)]))) == {
        "experiment": "lateral",
        "seed": "6",
        "steps": "2,007,040",
        "time": "1 min 02 s",
        "steps per second": "32,372",
    }
    assert estimates([row_with_statistics("lateral", True)]).header == (
        *("row", "clearances", "clearances, interquartile"),
        *("success", "success, interquartile", "losses of separation"),
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


def test_interquartile_means_are_shown_only_with_several_seeds():
    """Of one seed, they would repeat the means. One row with several seeds is enough."""
    one, several = (row_with_statistics("lateral", True, seeds) for seeds in (1, 2))
    assert estimates([one]) == Table(
        ("row", "clearances", "success", "losses of separation"),
        (("damped and stacked", "7.2 [6.9, 7.5]", "98.0 % [97.0, 99.0]", "0.5 % [0.0, 1.0]"),),
    )
    both = estimates([one, several])
    assert both.header == estimates([several]).header
    assert both.rows == estimates([several]).rows * 2
    assert estimates([row()]) == Table((), ())


def test_intervals_without_width_are_not_shown():
    """Rounded as shown: an interval that looks like its value is none."""
    assert interval(Estimate(7.2, 7.2, 7.2)) == "7.2"
    assert interval(Estimate(7.2, 7.16, 7.24)) == "7.2"
    assert interval(Estimate(7.2, 7.2, 7.3)) == "7.2 [7.2, 7.3]"
    assert interval(Estimate(7.2, 7.1, 7.2)) == "7.2 [7.1, 7.2]"
    assert interval(Estimate(7.2, 7.1, 7.1)) == "7.2 [7.1, 7.1]"
    assert percent_interval(Estimate(0.5, 0.4, 0.4)) == "50.0 % [40.0, 40.0]"
    assert percent_interval(Estimate(1.0, 1.0, 1.0)) == "100.0 %"
    assert percent_interval(Estimate(0.5, 0.5, 0.501)) == "50.0 % [50.0, 50.1]"
    assert percent_interval(Estimate(0.5, 0.499, 0.5)) == "50.0 % [49.9, 50.0]"
    assert percent_interval(Estimate(0.5, 0.496, 0.504), 0) == "50 %"


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


def test_rows_of_one_policy_are_adjacent_and_ours_first():
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


def test_estimates_and_comparisons_show_intervals():
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
    one = [row_with_statistics(each.experiment, each.stacking, 1) for each in both.rows]
    single = comparisons(results(rows=one, comparisons=both.comparisons)).rows[0]
    assert (single[2], single[4]) == (NOTHING, NOTHING)
    assert (single[1], single[3]) == ("-2.0 [-3.0, -1.0]", "-2.0 [-3.0, 1.0]")
    assert estimates(both.rows).rows[0] == (
        "damped and stacked",
        "7.2 [6.9, 7.5]",
        "7.1 [7.0, 7.3]",
        "98.0 % [97.0, 99.0]",
        "99.0 % [98.0, 100.0]",
        "0.5 % [0.0, 1.0]",
    )


def row_with_statistics(experiment, stacking, seeds=2):
    clearances = Statistics(Estimate(7.2, 6.9, 7.5), Estimate(7.1, 7.0, 7.3))
    success = Statistics(Estimate(0.98, 0.97, 0.99), Estimate(0.99, 0.98, 1.0))
    lost = Statistics(Estimate(0.005, 0.0, 0.01), Estimate(0.0, 0.0, 0.0))
    measures = {"clearances": clearances, "success": success, "loss_of_separation": lost}
    return row(experiment=experiment, stacking=stacking, seeds=seeds, statistics=measures)
