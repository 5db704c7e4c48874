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


def set_episodes(run, experiment, clearances, success):
    table = pa.table(
        {
            "scenario": np.arange(len(clearances), dtype=np.int32),
            "clearances": np.array(clearances, dtype=np.int32),
            "success": np.array(success),
            "min_separation_nm": np.full(len(success), np.inf),
            "loss_of_separation": np.zeros(len(success), dtype=bool),
        }
    )
    pq.write_table(table, run / FOLDER.format(experiment) / "episodes.parquet")


def set_aircraft(run, experiment, routes, climbs_fl):
    """Two aircraft a scenario, with these routes and climbs."""
    columns = {
        "scenario": np.repeat(np.arange(len(routes), dtype=np.int32), 2),
        "route": [route for pair in routes for route in pair],
        "entry_fl": [200] * (2 * len(routes)),
        "exit_fl": [200 + climb for climb in climbs_fl for _ in range(2)],
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
    ],
)
def test_the_scenario_shown_is_a_typical_success(run, clearances, success, typical):
    set_episodes(run, "lateral", clearances, success)
    set_aircraft(run, "lateral", [(THERE, ASIDE)] * 4, [0] * 4)
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


def test_vertical_control_is_shown_by_a_climb_of_15_instructions(family_run):
    run = family_run("vertical")
    # The only one lies beyond the scenarios of the histograms.
    climbs_fl = [-150] + [160] * 149 + [150]
    set_episodes(run, "vertical", [1] * 151, [True] * 151)
    set_aircraft(run, "vertical", [(THERE, THERE)] * 151, climbs_fl)
    assert chosen(run) == (150, "a climb of 150 levels")


def test_without_such_a_climb_the_largest_is_shown():
    starts = [Start((("A", "B"),), (climb,)) for climb in (-150, 40, 140, 140)]
    assert like_the_papers("vertical", starts).tolist() == [False, False, True, True]


def test_a_run_in_which_nobody_acts_shows_the_first(run):
    stored = json.loads((run / "results.json").read_text())
    rows = [stored["rows"][0] | {"experiment": "do-nothing"}]
    (run / "results.json").write_text(json.dumps(stored | {"rows": rows}))
    assert chosen(run) == (0, None)
