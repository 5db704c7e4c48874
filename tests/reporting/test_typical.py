"""The scenario that the pictures show: like the paper's, a success, instructive, and typical."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.reporting.flights import Start
from skystack.reporting.results import read_run
from skystack.reporting.typical import kind_of_scenario, resembles_paper, typical_scenario
from tests.reporting.conftest import change_row, write_run

FOLDER = "evaluation/{}-s0-skystack-stacked"
THERE, BACK, ASIDE = "A B C", "C B A", "A B D"


def set_episodes(run, experiment, clearances, success, first=0):
    table = pa.table(
        {
            "scenario": np.arange(first, first + len(clearances), dtype=np.int32),
            "clearances": np.array(clearances, dtype=np.int32),
            "success": np.array(success),
            "min_separation_nm": np.full(len(success), np.inf),
            "loss_of_separation": np.zeros(len(success), dtype=bool),
        }
    )
    pq.write_table(table, run / FOLDER.format(experiment) / "episodes.parquet")


def set_aircraft(run, experiment, routes, climbs_fl, first=0):
    """Two aircraft per scenario, with these routes and level changes."""
    columns = {
        "scenario": np.repeat(np.arange(first, first + len(routes), dtype=np.int32), 2),
        "route": [route for pair in routes for route in pair],
        "entry_fl": [200] * (2 * len(routes)),
        "exit_fl": [200 + one for climb in climbs_fl for one in np.broadcast_to(climb, 2)],
    }
    pq.write_table(pa.table(columns), run / FOLDER.format(experiment) / "aircraft.parquet")


def chosen(run):
    loaded = read_run(run)
    number = typical_scenario(loaded, loaded.results.rows)
    return number, kind_of_scenario(loaded, loaded.results.rows, number)


@pytest.fixture
def family_run(tmp_path):
    """A function that writes a run of one experiment."""
    return lambda experiment: write_run(
        tmp_path / "run", rows=[(experiment, True)], seeds=(0,), scenarios=1
    )


@pytest.mark.parametrize(
    ("clearances", "success", "typical"),
    [
        ([2, 9, 6, 5], [True] * 4, {2, 3}),  # the mean is 5.5
        ([2, 9, 6, 5], [True, True, True, False], {2}),
        ([2, 9, 6, 5], [False, True, False, False], {1}),
        ([2, 9, 6, 5], [False] * 4, {2, 3}),
        ([0, 0, 0, 10, 3], [True] * 5, {4}),  # the mean is 2.6, most have none
    ],
)
def test_chooses_a_typical_success(run, clearances, success, typical):
    set_episodes(run, "lateral", clearances, success)
    set_aircraft(run, "lateral", [(THERE, ASIDE)] * len(success), [0] * len(success))
    number, kind = chosen(run)
    assert number in typical
    assert kind is None


def test_avoidance_prefers_reciprocal_routes(family_run):
    run = family_run("avoidance")
    set_episodes(run, "avoidance", [5, 5, 9, 2], [True, True, False, True])
    routes = [(THERE, ASIDE), (THERE, THERE), (THERE, BACK), (BACK, THERE)]
    set_aircraft(run, "avoidance", routes, [0] * 4)
    assert chosen(run) == (3, "two aircraft on reciprocal routes")
    set_aircraft(run, "avoidance", [(THERE, ASIDE)] * 4, [0] * 4)
    assert chosen(run) == (0, None)


@pytest.mark.parametrize(
    ("clearances", "success", "reciprocal", "expected"),
    [
        # Reciprocal routes come first, then success, then action, then closeness to the mean.
        ([1, 5, 5, 9], [False, True, False, True], [True, False, False, False], 0),
        ([1, 5, 5, 9], [True, True, False, True], [True, False, True, True], 0),
        ([1, 5, 6, 8], [True, True, False, True], [True, False, True, True], 3),
        ([1, 5, 6, 8], [False, True, False, False], [True, False, True, True], 2),
        ([1, 5, 6, 8], [True, False, False, True], [False, False, False, False], 3),
        ([0, 5, 6, 9], [True, True, True, True], [True, False, False, False], 0),
        ([0, 5, 6, 9], [True, False, False, False], [True, True, True, True], 0),
        ([0, 1, 1, 9], [True, False, False, True], [True, True, True, True], 3),
    ],
)
def test_order_of_the_criteria(family_run, clearances, success, reciprocal, expected):
    run = family_run("avoidance")
    set_episodes(run, "avoidance", clearances, success)
    routes = [(THERE, BACK if one else ASIDE) for one in reciprocal]
    set_aircraft(run, "avoidance", routes, [0] * 4)
    assert chosen(run)[0] == expected


@pytest.fixture
def two_rows(tmp_path):
    """Two trained policies on common scenarios, and doing nothing, which always fails."""
    rows = [("lateral", True), ("lateral-best", True), ("do-nothing-lateral", True)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(0,), scenarios=1)
    for (experiment, _), success_rate in zip(rows, (0.9, 0.9, 0.1), strict=True):
        change_row(run, experiment, success_rate=success_rate)

    def write(experiment, clearances, success, first=0):
        set_episodes(run, experiment, clearances, success, first)
        routes = [(THERE, ASIDE)] * len(clearances)
        set_aircraft(run, experiment, routes, [0] * len(clearances), first)

    write("do-nothing-lateral", [0] * 7, [False] * 7)
    return run, write


def test_every_policy_must_succeed(two_rows):
    run, write = two_rows
    write("lateral", [5, 5, 5, 5], [True, False, True, False])
    write("lateral-best", [5, 5, 5, 5], [False, False, True, True])
    assert chosen(run)[0] == 2


@pytest.mark.parametrize(
    ("clearances", "best", "idle", "expected"),
    [
        # The first scenario is the most typical, with the means of both rows, 5 and 4.
        ([5, 9, 1], [4, 6, 2], [False, False, False], 0),
        ([5, 9, 1], [4, 6, 2], [True, False, True], 1),
        ([5, 9, 1], [4, 6, 2], [True, True, False], 2),
        ([5, 9, 1], [4, 6, 2], [True, True, True], 0),
        # In the most typical scenario, only one of them acts.
        ([5, 9, 1], [0, 2, 0], [False, False, False], 1),
        ([0, 2, 0], [5, 9, 1], [False, False, False], 1),
        # In all but the second, both issue the same number of clearances.
        ([5, 9, 1], [5, 7, 1], [False, False, False], 1),
        ([5, 9, 1], [5, 9, 1], [False, False, False], 0),
        # The last of them is the only one that meets all conditions.
        ([5, 5, 0, 9], [5, 4, 4, 2], [False, True, False, False], 3),
    ],
)
def test_prefers_scenarios_that_require_action(two_rows, clearances, best, idle, expected):
    """Doing nothing fails, every policy acts, and their clearances differ."""
    run, write = two_rows
    write("lateral", clearances, [True] * len(clearances))
    write("lateral-best", best, [True] * len(best))
    write("do-nothing-lateral", [0] * len(idle), idle)
    assert chosen(run)[0] == expected


def test_success_is_more_important_than_action(two_rows):
    """Only the first succeeds; doing nothing does, too."""
    run, write = two_rows
    write("lateral", [1, 9, 5], [True, False, False])
    write("lateral-best", [1, 8, 4], [True, True, True])
    write("do-nothing-lateral", [0] * 3, [True, False, False])
    assert chosen(run)[0] == 0


def test_doing_nothing_need_not_have_been_evaluated(two_rows):
    run, write = two_rows
    write("lateral", [5, 9, 1], [True] * 3)
    write("lateral-best", [5, 7, 1], [True] * 3)
    path = run / "results.json"
    stored = json.loads(path.read_text())
    rows = [row for row in stored["rows"] if not row["experiment"].startswith("do-nothing")]
    path.write_text(json.dumps(stored | {"rows": rows}))
    assert len(rows) == 2
    assert chosen(run)[0] == 1


def test_chooses_among_scenarios_flown_by_doing_nothing(two_rows):
    run, write = two_rows
    write("lateral", [1, 2, 5], [False, False, True])
    write("lateral-best", [2, 1, 5], [False, True, True])
    write("do-nothing-lateral", [0, 0], [False, True])
    assert chosen(run)[0] in {0, 1}


def test_untrained_policies_do_not_count(two_rows):
    """One succeeds in less than 30 points more scenarios than doing nothing does, in 10 %."""
    run, write = two_rows
    write("lateral", [5, 9, 1], [True] * 3)
    write("lateral-best", [0, 4, 4], [False, True, False])
    assert chosen(run)[0] == 1
    change_row(run, "lateral-best", success_rate=0.39)
    assert chosen(run)[0] == 0
    change_row(run, "lateral-best", success_rate=0.4)
    assert chosen(run)[0] == 1


def test_nothing_is_chosen_if_no_policy_is_trained(family_run):
    run = family_run("avoidance")
    set_episodes(run, "avoidance", [5, 5], [False, True])
    set_aircraft(run, "avoidance", [(THERE, ASIDE), (THERE, BACK)], [0] * 2)
    assert chosen(run) == (1, "two aircraft on reciprocal routes")
    change_row(run, "avoidance", success_rate=0.29)
    assert chosen(run) == (0, None)


def test_distances_are_in_standard_deviations_of_each_policy(two_rows):
    """Their squares are added. Measured in clearances, only the second row would count."""
    run, write = two_rows
    write("lateral", [10, 11, 12, 12, 10], [True] * 5)  # mean 11, deviation 0.9: counted as 1
    write("lateral-best", [100, 300, 220, 180, 200], [True] * 5)  # mean 200, deviation 65
    # (1, 2.4), (0, 2.4), (1, 0.1), (1, 0.1), (1, 0)
    assert chosen(run)[0] == 4
    write("lateral-best", [100, 230, 300, 170, 200], [True] * 5)
    # (1, 2.2), (0, 0.2), (1, 2.2), (1, 0.2), (1, 0)
    assert chosen(run)[0] == 1


def test_mean_over_all_scenarios_but_choice_among_common_ones(two_rows):
    """The first row's mean is 5; over the scenarios that both flew, it is 2."""
    run, write = two_rows
    write("lateral", [2, 1, 4, 1, 9, 9, 9], [True] * 7)
    write("lateral-best", [3, 3, 3, 3], [True] * 4)
    assert chosen(run)[0] == 2


def test_returns_the_number_of_the_scenario(two_rows):
    run, write = two_rows
    write("lateral", [2, 9, 5], [True] * 3, first=40)
    write("lateral-best", [2, 9, 5], [True] * 3, first=40)
    assert chosen(run)[0] == 42


def test_chooses_among_the_first_100_scenarios(run):
    """The last of them is the most typical; the only success comes right after them."""
    set_episodes(run, "lateral", [1, 3] * 49 + [1, 2, 2], [False] * 100 + [True])
    set_aircraft(run, "lateral", [(THERE, ASIDE)] * 101, [0] * 101)
    assert chosen(run)[0] == 99


def test_vertical_control_prefers_a_climb_of_15_instructions(family_run):
    run = family_run("vertical")
    # The only such climb is beyond the first 100 scenarios.
    climbs_fl = [-150] + [160] * 149 + [150]
    set_episodes(run, "vertical", [1] * 151, [True] * 151)
    set_aircraft(run, "vertical", [(THERE, THERE)] * 151, climbs_fl)
    assert chosen(run) == (150, "a climb of 150 flight levels")


def test_largest_climb_of_two_aircraft_counts(family_run):
    run = family_run("vertical")
    set_episodes(run, "vertical", [1] * 3, [True] * 3)
    set_aircraft(run, "vertical", [(THERE, THERE)] * 3, [(140, 140), (150, 160), (-20, 150)])
    assert chosen(run) == (2, "a climb of 150 flight levels")
    set_aircraft(run, "vertical", [(THERE, THERE)] * 3, [(140, 0), (20, 30), (160, -150)])
    assert chosen(run) == (2, None)


def test_without_such_a_climb_chooses_the_largest():
    starts = [Start((("A", "B"),), (climb,)) for climb in (-150, 40, 140, 140)]
    assert resembles_paper("vertical", starts).tolist() == [False, False, True, True]


@pytest.mark.parametrize("name", ["do-nothing", "do-nothing-lateral"])
def test_chooses_the_first_scenario_if_no_policy_acts(run, name):
    stored = json.loads((run / "results.json").read_text())
    rows = [stored["rows"][0] | {"experiment": name}]
    (run / "results.json").write_text(json.dumps(stored | {"rows": rows}))
    assert chosen(run) == (0, None)
