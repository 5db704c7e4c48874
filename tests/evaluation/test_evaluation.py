"""Evaluation: its scenarios, tables and rows, against what is known about the sector."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.errors import InputError
from skystack.evaluation.evaluate import (
    Conditions,
    evaluate,
    evaluate_no_op,
    policy_task,
)
from skystack.evaluation.paper import paper_row
from skystack.evaluation.rollout import NO_OP_CONTROLLER, Controller, fly, network_controller
from skystack.evaluation.summary import aggregate, evaluation_folder
from skystack.evaluation.tables import make_tables
from skystack.learning.experiment import load_experiment
from skystack.learning.policy import Policy
from skystack.learning.seeds import scenario_key, training_key
from skystack.policies.shipped import find_policy
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

TABLES = ("episodes", "aircraft", "trajectories", "clearances")
EPISODES = 60


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture(scope="module")
def evaluated(folder):
    return evaluate(find_policy("lateral"), Conditions(episodes=EPISODES), folder)


@pytest.fixture(scope="module")
def tables(evaluated, folder):
    subfolder = evaluation_folder(folder, "lateral", evaluated.row["seed"], stacking=True)
    return {name: pq.read_table(subfolder / f"{name}.parquet") for name in TABLES}


def column(table, name):
    return np.array(table[name].to_pylist())


@pytest.mark.slow
def test_reports_an_action_outside_the_table():
    """Also in a compiled program, where an index outside an array raises no error."""
    task = build_task(NavigationSettings(cycles=4))
    invalid = Controller(lambda weights, observation, key: jnp.full((), 99, dtype=jnp.int32))
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: action is 99 \(allowed: .* to 4"):
        fly(task, invalid, 0, 2, stacking=True)


@pytest.mark.slow
def test_scenarios_depend_on_seed_and_number_only():
    task = build_task(NavigationSettings())
    few, many = (fly(task, NO_OP_CONTROLLER, 0, count, False).start for count in (3, 7))
    other = fly(task, NO_OP_CONTROLLER, 1, 3, False).start
    np.testing.assert_array_equal(few.position_nm, many.position_nm[:3])
    assert not np.array_equal(few.position_nm, other.position_nm)


def test_training_and_evaluation_never_share_a_key():
    def words(key):
        return tuple(np.asarray(jax.random.key_data(key)).tolist())

    evaluated = {words(scenario_key(seed, number)) for seed in range(5) for number in range(50)}
    trained = {words(training_key(seed)) for seed in range(50)}
    assert (len(evaluated), len(trained)) == (250, 50)
    assert not evaluated & trained


@pytest.mark.slow
def test_no_op_succeeds_where_both_routes_are_straight():
    """HERON-SWIFT and SWIFT-HERON need no instruction, every other route needs one."""
    experiment = load_experiment("lateral")
    flight = fly(build_task(experiment.task), NO_OP_CONTROLLER, 0, 300, False)
    routes = build_task(experiment.task).simulator.sector.routes
    straight = np.array([{"HERON", "SWIFT"} == {route[0], route[-1]} for route in routes])
    expected = straight[flight.start.route].all(axis=1)
    assert expected.sum() > 0
    # The metrics of a scenario are those of its last cycle.
    np.testing.assert_array_equal(flight.metrics["cycles"], flight.ran.sum(axis=1))
    assert not flight.reward[~flight.ran].any()
    result = evaluate_no_op(experiment, Conditions(episodes=300), None)
    np.testing.assert_array_equal(column(result.episodes, "success"), expected)
    assert result.row["clearances_mean"] == result.row["instructions_mean"] == 0.0
    assert result.row["experiment"] == "do-nothing-lateral"


@pytest.mark.slow
def test_tables_are_consistent(tables, evaluated):
    episodes, clearances = tables["episodes"], tables["clearances"]
    assert episodes.num_rows == EPISODES
    counts = np.bincount(column(clearances, "scenario"), minlength=EPISODES)
    np.testing.assert_array_equal(counts, column(episodes, "clearances"))
    stacked = np.bincount(
        column(clearances, "scenario"), column(clearances, "instructions"), minlength=EPISODES
    )
    np.testing.assert_array_equal(stacked, column(episodes, "instructions"))
    assert evaluated.row["clearances_mean"] == pytest.approx(counts.mean())
    assert evaluated.row["success_rate"] == pytest.approx(column(episodes, "success").mean())


def test_trajectories_have_a_row_per_aircraft_and_cycle(tables):
    trajectories = tables["trajectories"]
    cycles = column(tables["episodes"], "cycles")
    assert trajectories.num_rows == 2 * np.sum(cycles + 1)
    first = trajectories.slice(0, 2).to_pylist()
    assert [row["callsign"] for row in first] == ["AC1", "AC2"]
    assert [(row["cycle"], row["time_s"], row["status"]) for row in first] == [
        (0, 0, "before_entry")
    ] * 2
    assert first[0]["ground_speed_kt"] == pytest.approx(465.940793, abs=1e-3)
    last = [row for row in trajectories.to_pylist() if row["scenario"] == 0][-2:]
    assert last[0]["cycle"] == cycles[0]


def test_a_clearance_is_shown_one_row_later_and_flown_after_it(tables):
    """Issued in cycle k, it is cleared in row k+1, and the aircraft flies it from row k+2."""
    rows = {
        (row["scenario"], row["callsign"], row["cycle"]): row
        for row in tables["trajectories"].to_pylist()
        if row["scenario"] < 10
    }
    checked = 0
    for clearance in tables["clearances"].to_pylist():
        aircraft, cycle = (clearance["scenario"], clearance["callsign"]), clearance["cycle"]
        if clearance["scenario"] >= 10 or (*aircraft, cycle + 2) not in rows:
            continue
        row = rows[*aircraft, cycle + 1]
        assert row["cleared_heading_deg"] == clearance["value"] % 360
        turn = (clearance["value"] - row["heading_deg"] + 180) % 360 - 180
        if abs(turn) > 15 and row["status"] != "exited":
            assert (turn > 0) == (clearance["direction"] == "right")
        verb = f"turn {clearance['direction']}" if clearance["direction"] else "fly"
        text = f"{clearance['callsign']} {verb} heading {clearance['value'] or 360:03d}"
        assert clearance["text"] == text
        checked += 1
    assert checked > 10


def test_tables_contain_their_sector(tables):
    sector = json.loads(tables["trajectories"].schema.metadata[b"sector"])
    assert sector["name"] == "x-plus"
    assert len(sector["area"]) == 14
    assert len(sector["routes"]) == 10


def test_without_stacking_each_clearance_is_one_instruction():
    plain = evaluate(find_policy("lateral"), Conditions(episodes=EPISODES, stacking=False), None)
    assert plain.row["clearances_mean"] == plain.row["instructions_mean"]
    assert plain.row["paper"] == {"clearances_mean": 14.5, "clearances_std": 6.6}


@pytest.mark.slow
def test_sampling_is_reproducible_and_differs_from_greedy():
    sampled = Conditions(episodes=EPISODES, greedy=False)
    first, second = (evaluate(find_policy("lateral"), sampled, None) for _ in range(2))
    greedy = evaluate(find_policy("lateral"), Conditions(episodes=EPISODES), None)
    assert first.episodes.equals(second.episodes)
    assert not first.episodes.equals(greedy.episodes)


def test_aggregates_rows_of_several_seeds(evaluated):
    other = evaluate(find_policy("lateral"), Conditions(seed=1, episodes=EPISODES), None)
    row = aggregate([evaluated.row, other.row], [evaluated.episodes, other.episodes])
    assert (row["seeds"], row["episodes"]) == (2, 2 * EPISODES)
    both = (evaluated.row["clearances_mean"] + other.row["clearances_mean"]) / 2
    assert row["clearances_mean"] == pytest.approx(both)


def test_the_papers_numbers():
    assert paper_row("lateral-undamped", False) == {
        "clearances_mean": 113.0,
        "clearances_std": 15.9,
    }
    assert paper_row("lateral", True) == {"clearances_mean": 7.2, "clearances_std": 3.5}
    assert paper_row("lateral-large", False) == {"clearances_mean": 6.3, "clearances_std": 3.0}
    assert paper_row("lateral-large", True) is None


def test_rejects_a_policy_for_another_task_version():
    import msgspec

    policy = find_policy("lateral")
    newer = msgspec.structs.replace(policy.description, task_version=99)
    with pytest.raises(InputError, match="version 99"):
        policy_task(Policy(newer, policy.actor, policy.normaliser))


@pytest.mark.slow
def test_the_vertical_policy_issues_at_most_one_clearance():
    """None if the entry level is the exit level. Without stacking, one per ten levels."""
    policy = find_policy("vertical")
    stacked, plain = (
        make_tables(policy_task(policy), fly(policy_task(policy), controller, 0, 300, stacking))
        for controller in [network_controller(policy.actor, policy.normaliser, greedy=True)]
        for stacking in (True, False)
    )
    gap = np.abs(column(stacked.aircraft, "exit_fl") - column(stacked.aircraft, "entry_fl"))
    np.testing.assert_array_equal(column(stacked.episodes, "clearances"), gap > 0)
    np.testing.assert_array_equal(column(stacked.episodes, "instructions"), gap // 10)
    np.testing.assert_array_equal(column(plain.episodes, "clearances"), gap // 10)
    assert column(stacked.episodes, "success").all()
    first = stacked.clearances.slice(0, 1).to_pylist()[0]
    assert first["kind"] == "level"
    assert first["text"] == f"AC1 {first['direction']} FL{first['value']}"


@pytest.mark.slow
def test_tables_contain_the_type_of_each_aircraft(tmp_path):
    """Types and levels come from the experiment; the slow type flies at its own Mach number."""
    slow = '{type="AT76", mach=[0.4,0.4,0.4]}'
    changes = [f"task.fleet=[{{}},{slow}]", "task.level_fl=[280,300]", "task.cycles=98"]
    experiment = load_experiment("lateral", changes)
    evaluate_no_op(experiment, Conditions(episodes=20), tmp_path)
    (folder,) = tmp_path.iterdir()
    aircraft = pq.read_table(folder / "aircraft.parquet").to_pylist()
    rows = pq.read_table(folder / "trajectories.parquet").to_pylist()
    types = {(one["scenario"], one["callsign"]): one["type"] for one in aircraft}
    assert set(types.values()) == {"B753", "AT76"}
    assert {one["entry_fl"] for one in aircraft} == {280, 300}
    for row in rows:
        kelvin = 288.15 - 0.0065 * 30.48 * row["fl"]
        mach = row["ground_speed_kt"] / (np.sqrt(1.4 * 287.05287 * kelvin) * 3600.0 / 1852.0)
        if types[row["scenario"], row["callsign"]] == "AT76":
            assert mach == pytest.approx(0.4, rel=1e-4)
        else:
            assert mach > 0.75
