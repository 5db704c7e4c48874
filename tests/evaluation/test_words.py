"""Directions in the tables of evaluations, against the rows that follow them."""

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.evaluation.evaluate import Conditions, evaluate, evaluation_folder, policy_task
from skystack.evaluation.followed import STATUS, follow
from skystack.evaluation.rollout import fly, network_controller
from skystack.evaluation.stored import stored_scenario
from skystack.evaluation.tables import make_tables
from skystack.evaluation.tabulate import tabulate
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from skystack.policies.shipped import find_policy
from skystack.simulator.fleet import AircraftType
from skystack.tasks.registry import build_task

WAYS = {"left": -1, "right": 1, "descend": -1, "climb": 1, None: 0}


def compared(folder, column, delay):
    """Counts clearances whose direction is that of the rows, and of those where issue misleads."""
    rows = pq.read_table(folder / "trajectories.parquet").to_pylist()
    state = {(row["scenario"], row["callsign"], row["cycle"]): row for row in rows}
    right, misleading = 0, 0
    for given in pq.read_table(folder / "clearances.parquet").to_pylist():
        number, callsign, cycle = (given[name] for name in ("scenario", "callsign", "cycle"))
        issue, before, after = (
            state.get((number, callsign, row)) for row in (cycle, cycle + delay, cycle + delay + 1)
        )
        if after is None or after["status"] == "exited":
            continue
        way = after[column] - before[column]
        at_issue = given["value"] - issue[column]
        if column == "heading_deg":
            way, at_issue = ((each + 180.0) % 360.0 - 180.0 for each in (way, at_issue))
        assert WAYS[given["direction"]] == np.sign(way), given
        phrase = {None: ("fly", "maintain")}.get(given["direction"], (given["direction"],))
        assert any(word in given["text"] for word in phrase)
        right += 1
        misleading += np.sign(way) != np.sign(at_issue)
    return right, misleading


@pytest.mark.parametrize(
    ("policy", "column"), [("lateral-undamped", "heading_deg"), ("vertical", "fl")]
)
def test_directions_in_our_tables_are_flown(policy, column, tmp_path):
    evaluate(find_policy(policy), Conditions(episodes=40, stacking=False), tmp_path)
    folder = evaluation_folder(tmp_path, policy, 0, False)
    right, misleading = compared(folder, column, 1)
    assert right > 200
    assert misleading > 0 or column == "fl"  # this policy turns no climb round


def test_directions_in_bluesky_s_tables_are_flown(tmp_path):
    pytest.importorskip("bluesky")
    conditions = Conditions(episodes=3, stacking=False, platform="bluesky")
    evaluate(find_policy("lateral-undamped"), conditions, tmp_path)
    folder = evaluation_folder(tmp_path, "lateral-undamped", 0, False, "bluesky")
    assert compared(folder, "heading_deg", 0)[0] > 30


def test_a_flight_is_followed_as_an_evaluation_is(tmp_path):
    """Stored scenarios flown again: the status of every row and the least distance."""
    evaluate(find_policy("lateral-best"), Conditions(episodes=4), tmp_path)
    folder = evaluation_folder(tmp_path, "lateral-best", 0, True)
    episodes = pq.read_table(folder / "episodes.parquet").to_pylist()
    assert any(row["loss_of_separation"] for row in episodes)
    for row in episodes:
        only = [("scenario", "=", row["scenario"])]
        table = pq.read_table(folder / "trajectories.parquet", filters=only)
        stored = stored_scenario(folder, row["scenario"])
        seen = follow(stored, fly_scenario(Skystack(), stored).reports)
        assert [STATUS[each] for each in seen.status.reshape(-1)] == table["status"].to_pylist()
        assert seen.min_separation_nm == pytest.approx(row["min_separation_nm"], abs=1e-3)
        assert (seen.losses > 0) == row["loss_of_separation"]


def test_an_evaluation_s_fleet_goes_along_in_its_tables(tmp_path):
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
