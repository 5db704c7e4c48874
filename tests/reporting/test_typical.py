"""Which scenario the pictures show: like the paper's, a success, and typical."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.reporting.flights import Start
from skystack.reporting.results import read_run
from skystack.reporting.typical import kind_of_scenario, like_the_papers, typical_scenario
from tests.reporting.conftest import write_run

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
    """Two aircraft a scenario, with these routes and climbs."""
    columns = {
        "scenario": np.repeat(np.arange(first, first + len(routes), dtype=np.int32), 2),
        "route": [route for pair in routes for route in pair],
        "entry_fl": [200] * (2 * len(routes)),
        "exit_fl": [200 + one for climb in climbs_fl for one in np.broadcast_to(climb, 2)],
    }
    pq.write_table(pa.table(columns), run / FOLDER.format(experiment) / "aircraft.parquet")


def chosen(run):
    whole = read_run(run)
    number = typical_scenario(whole, whole.results.rows)
    return number, kind_of_scenario(whole, whole.results.rows, number)


@pytest.fixture
def family_run(tmp_path):
    """A run of one experiment."""
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
def test_the_scenario_shown_is_a_typical_success(run, clearances, success, typical):
    set_episodes(run, "lateral", clearances, success)
    set_aircraft(run, "lateral", [(THERE, ASIDE)] * len(success), [0] * len(success))
    number, kind = chosen(run)
    assert number in typical
    assert kind is None


def test_avoidance_is_shown_on_reciprocal_routes(family_run):
    run = family_run("avoidance")
    set_episodes(run, "avoidance", [5, 5, 9, 2], [True, True, False, True])
    routes = [(THERE, ASIDE), (THERE, THERE), (THERE, BACK), (BACK, THERE)]
    set_aircraft(run, "avoidance", routes, [0] * 4)
    assert chosen(run) == (3, "two aircraft on reciprocal routes")
    set_aircraft(run, "avoidance", [(THERE, ASIDE)] * 4, [0] * 4)
    assert chosen(run) == (0, None)


@pytest.mark.parametrize(
    ("clearances", "success", "reciprocal", "shown"),
    [
        # Like the paper's before success, success before what is typical (the mean is 5).
        ([1, 5, 5, 9], [False, True, False, True], [True, False, False, False], 0),
        ([1, 5, 5, 9], [True, True, False, True], [True, False, True, True], 0),
        ([1, 5, 6, 8], [True, True, False, True], [True, False, True, True], 3),
        ([1, 5, 6, 8], [False, True, False, False], [True, False, True, True], 2),
        ([1, 5, 6, 8], [True, False, False, True], [False, False, False, False], 3),
    ],
)
def test_what_counts_more_in_the_choice(family_run, clearances, success, reciprocal, shown):
    run = family_run("avoidance")
    set_episodes(run, "avoidance", clearances, success)
    routes = [(THERE, BACK if one else ASIDE) for one in reciprocal]
    set_aircraft(run, "avoidance", routes, [0] * 4)
    assert chosen(run)[0] == shown


@pytest.fixture
def two_rows(tmp_path):
    """Two policies on common scenarios, and one that does nothing."""
    rows = [("lateral", True), ("lateral-best", True), ("do-nothing", True)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(0,), scenarios=1)

    def flown(experiment, clearances, success, first=0):
        set_episodes(run, experiment, clearances, success, first)
        routes = [(THERE, ASIDE)] * len(clearances)
        set_aircraft(run, experiment, routes, [0] * len(clearances), first)

    flown("do-nothing", [0, 0], [False, False])
    return run, flown


def test_every_policy_must_succeed_in_it(two_rows):
    run, flown = two_rows
    flown("lateral", [5, 5, 5, 5], [True, False, True, False])
    flown("lateral-best", [5, 5, 5, 5], [False, False, True, True])
    assert chosen(run)[0] == 2


def test_it_is_typical_of_all_policies_each_by_its_own_spread(two_rows):
    """Squares of distances in standard deviations: in clearances the second row's alone count."""
    run, flown = two_rows
    flown("lateral", [10, 11, 12, 12, 10], [True] * 5)  # mean 11, deviation 0.9: counted as 1
    flown("lateral-best", [100, 300, 220, 180, 200], [True] * 5)  # mean 200, deviation 65
    # (1, 2.4), (0, 2.4), (1, 0.1), (1, 0.1), (1, 0)
    assert chosen(run)[0] == 4
    flown("lateral-best", [100, 230, 300, 170, 200], [True] * 5)
    # (1, 2.2), (0, 0.2), (1, 2.2), (1, 0.2), (1, 0)
    assert chosen(run)[0] == 1


def test_the_mean_is_that_of_all_its_scenarios_and_the_choice_among_common_ones(two_rows):
    """Of the first row the mean is 5, of those that both flew it is 2."""
    run, flown = two_rows
    flown("lateral", [2, 1, 4, 1, 9, 9, 9], [True] * 7)
    flown("lateral-best", [3, 3, 3, 3], [True] * 4)
    assert chosen(run)[0] == 2


def test_scenarios_keep_their_numbers(two_rows):
    run, flown = two_rows
    flown("lateral", [2, 9, 5], [True] * 3, first=40)
    flown("lateral-best", [2, 9, 5], [True] * 3, first=40)
    assert chosen(run)[0] == 42


def test_it_is_one_of_the_100_in_the_histograms(run):
    """The last of them is the most typical; the first that is not shown is the only success."""
    set_episodes(run, "lateral", [1, 3] * 49 + [1, 2, 2], [False] * 100 + [True])
    set_aircraft(run, "lateral", [(THERE, ASIDE)] * 101, [0] * 101)
    assert chosen(run)[0] == 99


def test_vertical_control_is_shown_by_a_climb_of_15_instructions(family_run):
    run = family_run("vertical")
    # The only one lies beyond the scenarios of the histograms.
    climbs_fl = [-150] + [160] * 149 + [150]
    set_episodes(run, "vertical", [1] * 151, [True] * 151)
    set_aircraft(run, "vertical", [(THERE, THERE)] * 151, climbs_fl)
    assert chosen(run) == (150, "a climb of 150 flight levels")


def test_one_of_two_aircraft_must_climb_as_the_papers_does(family_run):
    run = family_run("vertical")
    set_episodes(run, "vertical", [1] * 3, [True] * 3)
    set_aircraft(run, "vertical", [(THERE, THERE)] * 3, [(140, 140), (150, 160), (-20, 150)])
    assert chosen(run) == (2, "a climb of 150 flight levels")
    set_aircraft(run, "vertical", [(THERE, THERE)] * 3, [(140, 0), (20, 30), (160, -150)])
    assert chosen(run) == (2, None)


def test_without_such_a_climb_the_largest_is_shown():
    starts = [Start((("A", "B"),), (climb,)) for climb in (-150, 40, 140, 140)]
    assert like_the_papers("vertical", starts).tolist() == [False, False, True, True]


def test_a_run_in_which_nobody_acts_shows_the_first(run):
    stored = json.loads((run / "results.json").read_text())
    rows = [stored["rows"][0] | {"experiment": "do-nothing"}]
    (run / "results.json").write_text(json.dumps(stored | {"rows": rows}))
    assert chosen(run) == (0, None)
