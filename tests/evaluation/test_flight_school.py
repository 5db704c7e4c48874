"""Flight School: seeds in parallel, cached, with failures of single seeds."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats

from skystack.errors import InputError
from skystack.evaluation import flight_school, workers
from skystack.evaluation.flight_school import fly_flight_school, interval
from skystack.evaluation.hour_row import read_row
from skystack.evaluation.hour_tables import TABLES
from skystack.evaluation.traffic import evaluate_traffic
from skystack.evaluation.traffic_conditions import TrafficConditions

CONDITIONS = TrafficConditions("60", cycles=60)
USERS = "tests.agents.user_controllers"
LIMIT_S = 600.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    out = tmp_path_factory.mktemp("flight-school")
    cycles = []
    result = fly_flight_school(
        "own-navigation", CONDITIONS, [3, 4, 5], out, LIMIT_S, lambda *told: cycles.append(told)
    )
    return result, out, cycles


@pytest.mark.slow
def test_each_seed_is_the_first_hour_of_that_evaluation_seed(flown):
    result, _, _ = flown
    rows = [
        evaluate_traffic("own-navigation", CONDITIONS._replace(seed=seed)) for seed in (3, 4, 5)
    ]
    assert result.row["lax_s_by_seed"] == [row["lax_s_mean"] for row in rows]
    assert result.row["flights"] == sum(row["flights"] for row in rows)
    assert result.row["losses_of_separation"] == sum(row["losses_of_separation"] for row in rows)
    assert result.row["seed_numbers"] == [3, 4, 5]
    assert result.row["seeds"] == 3
    assert result.failed == {}


@pytest.mark.slow
def test_the_tables_have_all_seeds(flown):
    result, out, _ = flown
    assert result.folder == out / "own-navigation-flight-school-60-cycles-60"
    tables = {path.stem: pq.read_table(path) for path in result.folder.glob("*.parquet")}
    assert set(tables) == set(TABLES)
    assert tables["episodes"]["scenario"].to_pylist() == [3, 4, 5]
    assert tables["aircraft"].num_rows == result.row["flights"]
    assert json.loads((result.folder / "row.json").read_text())["seeds"] == 3
    assert read_row(result.folder).seeds == [3, 4, 5]


@pytest.mark.slow
def test_progress_counts_the_cycles_of_all_seeds(flown):
    _, _, cycles = flown
    numbers = [number for number, _ in cycles]
    assert numbers == sorted(numbers)
    assert cycles[-1] == (180, 180)


@pytest.mark.slow
def test_finished_seeds_are_not_flown_again(flown):
    result, out, _ = flown
    cycles = []
    again = fly_flight_school(
        "own-navigation", CONDITIONS, [4, 3], out, LIMIT_S, lambda *told: cycles.append(told)
    )
    assert (again.cached, cycles) == (2, [])
    by_seed = dict(zip(result.row["seed_numbers"], result.row["lax_s_by_seed"], strict=True))
    assert again.row["lax_s_by_seed"] == [by_seed[4], by_seed[3]]
    more = fly_flight_school("own-navigation", CONDITIONS, [3, 4, 5, 6], out, LIMIT_S)
    assert more.cached == 3
    assert more.row["lax_s_by_seed"][:3] == result.row["lax_s_by_seed"]


@pytest.mark.slow
def test_one_seed_that_fails_does_not_end_the_others(tmp_path):
    """With about five births in expectation, some seeds have five flights at once."""
    some = TrafficConditions("30", cycles=100)
    result = fly_flight_school(f"{USERS}:Overwhelmed", some, range(6), tmp_path, LIMIT_S)
    assert 0 < len(result.failed) < 6
    for reason in result.failed.values():
        assert "generate_action failed: RuntimeError: too many flights (user_contr" in reason
        assert reason.startswith("cycle ")
    assert result.row["seed_numbers"] == [each for each in range(6) if each not in result.failed]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "message"),
    [
        ("Raises", "all seeds failed: seed 0, cycle 0, generate_action failed: ValueError: two l"),
        ("Dies", r"all seeds failed: seed 0, cycle 2: its process died \(exit code 7\)"),
        ("NeedsAnArgument", "all seeds failed: seed 0, cannot create an instance: TypeError"),
    ],
)
def test_if_all_seeds_fail_nothing_is_left_behind(tmp_path, controller, message):
    with pytest.raises(InputError, match=message):
        fly_flight_school(f"{USERS}:{controller}", CONDITIONS, [0], tmp_path / "out", LIMIT_S)
    assert not (tmp_path / "out").exists()


def test_a_controller_that_has_changed_since_the_start_is_not_flown(tmp_path):
    job = flight_school._Job("own-navigation", CONDITIONS, tmp_path, "digest of another version")
    with pytest.raises(InputError, match=r"own-navigation or skystack has changed"):
        flight_school._worker(job)


@pytest.mark.slow
def test_nothing_that_a_controller_stores_reaches_another_hour(tmp_path, monkeypatch):
    """Not in its class, in a module of its own, or in a library; and its files are checked."""
    monkeypatch.setattr(workers, "cores", lambda: [None])
    counts = "hours = []"
    own = (
        "import json, part\nclass Counts:\n    hours = []\n"
        "    def generate_action(self, env, observation, info):\n"
        "        if info['sim_time'] == 0.0:\n"
        "            self.hours.append(1), part.hours.append(1)\n"
        "            json.hours = getattr(json, 'hours', 0) + 1\n"
        "        if len(self.hours) + len(part.hours) + json.hours != 3:\n"
        "            raise ValueError('leaks')\n"
        "        return {}\n"
    )
    (tmp_path / "own.py").write_text(own)
    (tmp_path / "part.py").write_text(counts)
    short = CONDITIONS._replace(cycles=2)

    def fly():
        return fly_flight_school(f"{tmp_path}/own.py:Counts", short, [0, 1], tmp_path, LIMIT_S)

    assert fly().failed == {}
    assert fly().cached == 2
    (tmp_path / "part.py").write_text(counts + "  # changed")
    again = fly()
    assert (again.cached, again.outdated, again.failed) == (0, 2, {})


@pytest.mark.slow
def test_a_controller_may_change_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = CONDITIONS._replace(cycles=3)
    result = fly_flight_school(f"{USERS}:ChangesFolder", short, [0], Path("here"), LIMIT_S)
    assert result.failed == {}
    assert (tmp_path / "here" / result.folder.name / "row.json").exists()


@pytest.mark.slow
def test_a_decision_that_takes_too_long_fails(tmp_path):
    """It takes ten minutes, and the limit is twenty seconds."""
    few = CONDITIONS._replace(cycles=5)
    with pytest.raises(InputError, match="seed 0, cycle 2: took longer than 20 s"):
        fly_flight_school(f"{USERS}:Hangs", few, [0], tmp_path / "out", 20.0)


@pytest.mark.parametrize(
    ("agent", "conditions", "seeds", "message"),
    [
        ("serch", CONDITIONS, [0], "unknown agent 'serch'; did you mean 'search'?"),
        ("search", CONDITIONS, [], r"0 seeds \(allowed: 1 to 100,000"),
        ("search", CONDITIONS, [-1], r"seeds -1 to -1 \(allowed: 0 to"),
        ("search", CONDITIONS, range(2**30), r"1073741824 seeds \(allowed"),
        (f"{USERS}.py", CONDITIONS, [0], "has no class"),
        ("", CONDITIONS, [0], "unknown agent ''"),
        ("search", CONDITIONS._replace(traffic="0"), [0], "flights per hour is 0.0"),
        ("search", CONDITIONS._replace(traffic="lots"), [0], "traffic 'lots'"),
        ("search", CONDITIONS._replace(platform="bluebrd"), [0], "bluebrd"),
        ("lateral", CONDITIONS, [0], "trained on task lateral"),
        (f"{USERS}:Nobody", CONDITIONS._replace(safety_net=False), [0], "has no safety net"),
    ],
)
def test_invalid_conditions_are_one_line_and_write_nothing(
    tmp_path, agent, conditions, seeds, message
):
    with pytest.raises(InputError, match=message):
        fly_flight_school(agent, conditions, seeds, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_interval_is_that_of_students_t():
    """Of 0 and 2: the mean is 1, its standard error 1, and t with one degree of freedom 12.706."""
    low, high = interval([0.0, 2.0])
    assert (low, high) == pytest.approx((1.0 - 12.7062, 1.0 + 12.7062), abs=1e-3)
    values = np.random.default_rng(0).normal(size=30)
    expected = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert interval(values.tolist()) == pytest.approx((expected.low, expected.high))
    assert interval([5.0]) is None
