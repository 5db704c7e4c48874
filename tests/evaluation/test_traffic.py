"""Evaluation on hours of traffic: conditions, rows and tables."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.airspace.sectors import sector_named
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hour_tables import TABLES
from skystack.evaluation.traffic import _is_x_plus, evaluate_traffic, hours_folder
from skystack.evaluation.traffic_conditions import TrafficConditions, flow_of, traffic_name
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator

SIMULATOR = Simulator(x_plus(), performance("constant"), own_navigation=True)
KEYS = {
    "agent", "traffic", "hours", "flights", "losses_of_separation", "losses_at_birth",
    "correct_exit_rate", "excursion_rate", "transmissions_per_flight",
    "transmissions_worst_minute", "fail_safe_rate", "exit_offset_nm_median", "extra_miles_rate",
    "lax_s_mean", "strict_s_mean", "decision_ms_median",
}  # fmt: skip


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hours") / "out"
    counted = []
    conditions = TrafficConditions("80", hours=2, cycles=240)
    row = evaluate_traffic("own-navigation-exit-level", conditions, folder, counted.append)
    return row, folder, counted


@pytest.mark.slow
def test_the_row_has_what_is_promised(evaluated):
    row, _, counted = evaluated
    assert set(row) >= KEYS
    assert row["agent"] == "own-navigation-exit-level"
    assert row["traffic"] == "80"
    assert row["hours"] == pytest.approx(0.8)
    assert row["transmissions_per_flight"] <= 1.0
    assert 0.0 < row["fail_safe_rate"] < 1.0
    assert counted == list(range(1, 481))


@pytest.mark.slow
def test_the_tables_agree_with_the_row(evaluated):
    row, out, _ = evaluated
    (folder,) = out.iterdir()
    assert folder.name == "own-navigation-exit-level-traffic-80-seed-0"
    tables = {path.stem: pq.read_table(path) for path in folder.glob("*.parquet")}
    assert set(tables) == set(TABLES)
    assert tables["aircraft"].num_rows == row["flights"]
    assert tables["losses"].num_rows == row["losses_of_separation"]
    episodes = tables["episodes"].to_pydict()
    assert episodes["scenario"] == [0, 1]
    assert sum(episodes["transmissions"]) == pytest.approx(
        row["transmissions_per_flight"] * row["flights"]
    )
    assert np.mean(episodes["lax_s"]) == row["lax_s_mean"]
    sent = {(each["scenario"], each["transmission"]) for each in tables["clearances"].to_pylist()}
    assert len(sent) == sum(episodes["transmissions"])


@pytest.mark.slow
def test_equal_conditions_give_equal_rows(evaluated):
    again = evaluate_traffic(
        "own-navigation-exit-level", TrafficConditions("80", hours=2, cycles=240)
    )
    timed = {"decision_ms_median", "decision_ms_p99"}
    assert {key: value for key, value in again.items() if key not in timed} == {
        key: value for key, value in evaluated[0].items() if key not in timed
    }


@pytest.mark.parametrize(
    ("traffic", "message"),
    [
        ("0", "flights per hour is 0.0"),
        ("-3", "flights per hour is -3.0"),
        ("nan", "flights per hour is nan"),
        ("1e9", "flights per hour is 1000000000.0"),
        (
            "categories",
            "unknown traffic 'categories'; did you mean 'category'? (allowed: ",
        ),
    ],
)
def test_impossible_traffic_is_refused(traffic, message):
    with pytest.raises(InputError) as raised:
        flow_of(TrafficConditions(traffic), SIMULATOR)
    assert message in str(raised.value)


@pytest.mark.parametrize(("rate", "slots"), [("10", 16), ("60", 64), ("120", 64), ("200", 128)])
def test_slots_suffice_for_the_rate(rate, slots):
    assert flow_of(TrafficConditions(rate), SIMULATOR).slots == slots


def test_uncertainty_spreads_speeds_and_rates_of_climb():
    flow = flow_of(TrafficConditions("60", uncertainty=True), SIMULATOR)
    assert (flow.speed_spread, flow.climb_spread) == (0.03, 0.10)
    assert flow_of(TrafficConditions("category"), SIMULATOR).starters == 2


def test_policies_of_other_tasks_are_refused():
    with pytest.raises(InputError, match="trained on task lateral"):
        evaluate_traffic("lateral-best", TrafficConditions("60"))


def test_a_row_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    conditions = TrafficConditions("60", cycles=5)
    folder = hours_folder(tmp_path, "no-op", conditions)
    (folder / "row.json").mkdir(parents=True)
    with pytest.raises(InputError, match=r"row\.json: cannot be written: it is a folder"):
        evaluate_traffic("no-op", conditions, tmp_path)
    assert list(folder.glob("*.parquet")) == []


@pytest.mark.parametrize(
    ("traffic", "name"), [("60.0", "60"), (" 6e1", "60"), ("category", "category"), ("x", "x")]
)
def test_rates_are_written_alike(traffic, name):
    assert traffic_name(traffic) == name


def test_only_policies_have_a_safety_net():
    without = TrafficConditions("60", safety_net=False)
    assert not find_controller("sector-control", without).agent.safety_net
    with pytest.raises(InputError, match="search has no safety net"):
        find_controller("search", without)


def test_unknown_agents_are_refused():
    with pytest.raises(InputError, match="unknown agent 'serch'; did you mean 'search'"):
        evaluate_traffic("serch", TrafficConditions("60"))


def test_another_sector_may_be_named_or_in_a_file():
    file = Path(__file__).parents[2] / "examples" / "own-sector" / "valley.json"
    for sector, name in ((str(file), "valley"), ("crossing", "crossing")):
        conditions = TrafficConditions("60", sector=sector)
        assert find_controller("search", conditions).world.sector.name == name


def test_a_policy_flies_with_the_performance_model_of_its_training():
    found = find_controller("sector-control", TrafficConditions("60"))
    assert (found.name, found.performance) == ("sector-control", "constant")
    assert found.world.simulator.performance == performance("constant")


@pytest.mark.parametrize(
    ("sector", "is_x_plus"),
    [("x-plus", True), ("bluebird:Xplus-Sector", True), ("merge", False), ("crossing", False)],
)
def test_bluebird_flies_its_traffic_in_x_plus_only(sector, is_x_plus):
    if sector.startswith("bluebird:"):
        pytest.importorskip("bluebird_dt")
    assert _is_x_plus(sector_named(sector)) == is_x_plus
