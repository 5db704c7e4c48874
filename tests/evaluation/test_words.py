"""Tables of evaluations against flights: directions of clearances, status, separation, fleet."""

import msgspec
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from skystack.evaluation.evaluate import Conditions, evaluate, policy_task
from skystack.evaluation.followed import STATUS, follow
from skystack.evaluation.rollout import NO_OP_CONTROLLER, fly, network_controller
from skystack.evaluation.stored import stored_scenario
from skystack.evaluation.summary import evaluation_folder
from skystack.evaluation.tables import make_tables
from skystack.evaluation.tabulate import tabulate
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from skystack.policies.shipped import find_policy
from skystack.simulator.fleet import AircraftType
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

SIGNS = {"left": -1, "right": 1, "descend": -1, "climb": 1, None: 0}


def count_directions(folder, column, delay):
    """Check directions against the rows; count them, and those that would differ from issue."""
    rows = pq.read_table(folder / "trajectories.parquet").to_pylist()
    state = {(row["scenario"], row["callsign"], row["cycle"]): row for row in rows}
    checked, reversed_since_issue = 0, 0
    for clearance in pq.read_table(folder / "clearances.parquet").to_pylist():
        number, callsign, cycle = (clearance[name] for name in ("scenario", "callsign", "cycle"))
        issue, before, after = (
            state.get((number, callsign, row)) for row in (cycle, cycle + delay, cycle + delay + 1)
        )
        if after is None or after["status"] == "exited":
            continue
        change = after[column] - before[column]
        at_issue = clearance["value"] - issue[column]
        if column == "heading_deg":
            change, at_issue = ((each + 180.0) % 360.0 - 180.0 for each in (change, at_issue))
        assert SIGNS[clearance["direction"]] == np.sign(change), clearance
        words = {None: ("fly", "maintain")}.get(clearance["direction"], (clearance["direction"],))
        assert any(word in clearance["text"] for word in words)
        checked += 1
        reversed_since_issue += np.sign(change) != np.sign(at_issue)
    return checked, reversed_since_issue


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "column"), [("lateral-undamped", "heading_deg"), ("vertical", "fl")]
)
def test_directions_in_our_tables_match_the_flight(policy, column, tmp_path):
    evaluate(find_policy(policy), Conditions(episodes=40, stacking=False), tmp_path)
    folder = evaluation_folder(tmp_path, policy, 0, False)
    checked, reversed_since_issue = count_directions(folder, column, 1)
    assert checked > 200
    assert reversed_since_issue > 0 or column == "fl"  # this policy reverses no climb


@pytest.mark.slow
@pytest.mark.usefixtures("one_process")
def test_directions_in_bluesky_tables_match_the_flight(tmp_path):
    pytest.importorskip("bluesky")
    conditions = Conditions(episodes=3, stacking=False, platform="bluesky")
    evaluate(find_policy("lateral-undamped"), conditions, tmp_path)
    folder = evaluation_folder(tmp_path, "lateral-undamped", 0, False, "bluesky")
    assert count_directions(folder, "heading_deg", 0)[0] > 30


@pytest.mark.slow
def test_follow_gives_the_status_and_separation_of_the_tables(tmp_path):
    """For stored scenarios that are flown again."""
    evaluate(find_policy("lateral-best"), Conditions(episodes=4), tmp_path)
    folder = evaluation_folder(tmp_path, "lateral-best", 0, True)
    episodes = pq.read_table(folder / "episodes.parquet").to_pylist()
    assert any(row["loss_of_separation"] for row in episodes)
    for row in episodes:
        only = [("scenario", "=", row["scenario"])]
        table = pq.read_table(folder / "trajectories.parquet", filters=only)
        stored = stored_scenario(folder, row["scenario"])
        followed = follow(stored, fly_scenario(Skystack(), stored).reports)
        assert [STATUS[each] for each in followed.status.reshape(-1)] == table["status"].to_pylist()
        assert followed.min_separation_nm == pytest.approx(row["min_separation_nm"], abs=1e-3)
        assert (followed.losses > 0) == row["loss_of_separation"]


@pytest.mark.slow
def test_an_aircraft_that_starts_inside_is_in_the_sector_at_once(tmp_path):
    settings = msgspec.structs.replace(NavigationSettings(), disc_nm=30.0, cycles=98)
    task = build_task(settings)
    tabulate(task, iter([fly(task, NO_OP_CONTROLLER, 0, 7, True)]), tmp_path)
    rows = pq.read_table(tmp_path / "trajectories.parquet", filters=[("cycle", "=", 0)])
    assert set(rows["status"].to_pylist()) == {"before_entry", "in_sector"}
    for number in (3, 4, 6):
        stored = stored_scenario(tmp_path, number)
        followed = follow(stored, fly_scenario(Skystack(), stored).reports)
        at_start = rows.filter(pc.equal(rows["scenario"], number))["status"].to_pylist()
        assert [STATUS[each] for each in followed.status[0]] == at_start


@pytest.mark.slow
def test_a_stored_scenario_flies_with_the_fleet_of_its_tables(tmp_path):
    policy = find_policy("lateral-best")
    slow = AircraftType("AT76", 1.0, (160.0,) * 3, (170.0,) * 3, (0.44,) * 3, 1200.0)
    settings = policy_task(policy).settings
    task = build_task(msgspec.structs.replace(settings, fleet=(slow,), cycles=5))
    controller = network_controller(policy.actor, policy.normaliser, True)
    flown = fly(task, controller, 0, 2, True)
    tables = make_tables(task, flown)
    tabulate(task, iter([flown]), tmp_path)
    stored = stored_scenario(tmp_path, 1)
    assert stored.fleet == (slow,)
    again = fly_scenario(Skystack(), stored).reports[-1]
    rows = tables.trajectories.to_pylist()[-2:]
    for name in ("ground_speed_kt", "lat", "lon"):
        np.testing.assert_allclose(getattr(again, name), [row[name] for row in rows], atol=1e-4)
