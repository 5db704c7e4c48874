"""Scenarios as traffic: those of an experiment's evaluation, and those of files."""

import json
from pathlib import Path

import numpy as np
import pytest

from skystack.errors import InputError
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hours import OwnHours
from skystack.evaluation.scenario_traffic import is_scenario, scenario_world
from skystack.evaluation.traffic import evaluate_traffic
from skystack.evaluation.traffic_conditions import (
    TrafficConditions,
    cycles_of,
    is_named,
    traffic_name,
)
from skystack.evaluation.writing import TrafficRecord
from skystack.learning.experiment import load_experiment
from skystack.learning.seeds import scenario_key
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.registry import build_task

FILE = "examples/head-on.json"


@pytest.mark.parametrize("name", ["lateral", "vertical"])
def test_an_experiment_has_the_scenarios_of_its_evaluation(name):
    found = scenario_world(name)
    task = build_task(load_experiment(name).task)
    state = OwnHours(found.world).reset(3, 4)
    drawn = task.scenarios.draw(scenario_key(3, 4))
    count = task.aircraft
    np.testing.assert_allclose(
        state.traffic.position_nm[:count], drawn.traffic.position_nm, rtol=1e-6
    )
    np.testing.assert_array_equal(state.arrivals.exit_level_ticks[:count], drawn.exit_level_ticks)
    assert found.cycles == cycles_of(name) == 300


def test_a_file_has_its_callsigns_levels_and_length(tmp_path):
    listed = json.loads(Path(FILE).read_text())
    listed["aircraft"][1]["exit_fl"] = 340
    listed |= {"cycles": 77, "clearances": []}
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(listed))
    found = scenario_world(str(path))
    state = OwnHours(found.world).reset(0, 0)
    assert found.world.flow.callsigns == tuple(each["callsign"] for each in listed["aircraft"])
    assert (state.arrivals.exit_level_ticks / TICKS_PER_FL).tolist() == [300.0, 340.0]
    assert found.cycles == 77


def test_names():
    assert all(map(is_scenario, ("lateral", FILE, "own.toml")))
    assert not any(map(is_scenario, ("60", "category", "springfield:x", "latral")))
    assert is_named("head-on.json")
    assert traffic_name("flight-school") == "category"
    assert cycles_of("60") == 600


def test_files_are_recorded_without_their_folder():
    conditions = TrafficConditions(f"a/folder/{FILE}")
    assert (conditions.recorded_traffic, conditions.traffic_in_names) == ("head-on.json",) * 2


def test_a_scenario_is_the_same_in_all_simulators():
    record = TrafficRecord("a", "lateral", 0, False)
    other = TrafficRecord("b", "lateral", 0, False, platform="bluebird")
    assert record.is_same_as(other)
    assert not record.is_same_as(TrafficRecord("b", "lateral", 1, False))


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        (
            TrafficConditions("sector-control"),
            "an experiment with arriving flights",
        ),
        (TrafficConditions("none.json"), "none.json: cannot be read"),
        (TrafficConditions("latral"), "an experiment, or a scenario file"),
        (TrafficConditions(FILE, hours=2), "is the same in every hour"),
        (TrafficConditions("lateral", sector="merge"), "--sector cannot be used with traffic"),
        (TrafficConditions("lateral", uncertainty=True), "--uncertainty cannot be used"),
    ],
)
def test_conditions_that_cannot_be_flown_are_refused(conditions, message):
    with pytest.raises(InputError) as error:
        evaluate_traffic("no-op", conditions)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("policy", "conditions", "message"),
    [
        ("vertical", TrafficConditions("lateral"), "a policy for 1 aircraft"),
        ("lateral-best", TrafficConditions("60"), "trained on task lateral (allowed with this"),
        (
            "lateral-best",
            TrafficConditions("lateral", safety_net=False),
            "lateral-best has no safety net",
        ),
    ],
)
def test_a_policy_that_does_not_fit_is_refused(policy, conditions, message):
    with pytest.raises(InputError) as error:
        find_controller(policy, conditions)
    assert message in str(error.value)


def test_mvp_flies_arriving_traffic_only():
    pytest.importorskip("bluesky")
    with pytest.raises(InputError, match=r"mvp with a scenario \(allowed: arriving traffic"):
        evaluate_traffic("mvp", TrafficConditions("lateral", platform="bluesky"))


@pytest.mark.slow
def test_evaluates_an_agent_on_a_scenario(tmp_path):
    row = evaluate_traffic("no-op", TrafficConditions(FILE, cycles=75), tmp_path)
    assert (row["traffic"], row["flights"]) == ("head-on.json", 2)
    assert row["losses_of_separation"] == 1
    assert (tmp_path / "no-op-traffic-head-on.json-seed-0" / "row.json").exists()
