"""Tables of hand-made recordings: every value is known without flying."""

from dataclasses import replace

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.evaluation.tables import make_tables
from skystack.evaluation.tabulate import tabulate
from skystack.platforms.adoption import BLUESKY, SKYSTACK
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.actions import level_changes
from skystack.tasks.contract import AircraftStatus
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

from .recordings import metrics, recording

FLEET = (AircraftType(), AircraftType("AT76"))
SETTINGS = NavigationSettings(fleet=FLEET)
TURNS = build_task(SETTINGS)
"""Actions: none, AC1 left, AC1 right, AC2 left, AC2 right."""
LEVELS = replace(TURNS, table=level_changes(2, (200, 400)))
"""Actions: none, AC1 down, AC1 up, AC2 down, AC2 up."""
AC1_RIGHT, AC2_LEFT, AC2_RIGHT, AC2_DOWN = 2, 3, 4, 3


def actions_of(clearances, stacked=1):
    """Actions that issue these numbers of clearances to AC1 and AC2, each compiled from `stacked`
    instructions."""
    cycles = 70
    action = np.zeros((len(clearances), cycles), dtype=np.int32)
    for scenario, (first, second) in enumerate(clearances):
        action[scenario, : first + second] = [AC1_RIGHT] * first + [AC2_LEFT] * second
    return {"action": action, "instructions": np.where(action > 0, stacked, 0).astype(np.int32)}


def test_few_clearances_are_fewer_than_30_per_aircraft():
    """The instructions that they were compiled from do not count."""
    clearances = [(29, 29), (30, 0), (0, 30), (3, 2)]
    flown = recording([0, 1, 2, 3], np.ones((4, 70)), **actions_of(clearances, stacked=20))
    episodes = make_tables(TURNS, flown).episodes
    assert episodes["few_clearances"].to_pylist() == [True, False, False, True]
    assert episodes["success"].to_pylist() == [True, False, False, True]
    assert episodes["clearances"].to_pylist() == [58, 30, 30, 5]
    assert episodes["instructions"].to_pylist() == [1160, 600, 600, 100]


def test_many_clearances_may_succeed_without_the_count_criterion():
    reward = RewardSettings(count_criterion=False)
    task = build_task(msgspec.structs.replace(SETTINGS, reward=reward))
    flown = recording([0], np.ones((1, 70)), **actions_of([(40, 0)]))
    episodes = make_tables(task, flown).episodes
    assert episodes["few_clearances"].to_pylist() == [False]
    assert episodes["success"].to_pylist() == [True]


def test_success_is_a_correct_exit_without_an_excursion():
    """One case of four; the task's own success metric, which counts instructions, is ignored."""
    ends = metrics(4, correct_exit=[1, 1, 0, 0], excursion=[0, 1, 0, 1], success=False)
    flown = recording(range(4), np.ones((4, 2)), metrics=ends)
    episodes = make_tables(TURNS, flown).episodes
    assert episodes["correct_exit"].to_pylist() == [True, True, False, False]
    assert episodes["excursion"].to_pylist() == [False, True, False, True]
    assert episodes["success"].to_pylist() == [True, False, False, False]


def test_a_separation_equal_to_the_standard_is_no_loss():
    below = TURNS.sector.loss_below_nm
    assert 4.999 < below < 5.0
    least = np.array([5.0, below, np.nextafter(below, 0.0), 0.0, np.inf])
    flown = recording(range(5), np.ones((5, 2)), metrics=metrics(5, min_separation_nm=least))
    episodes = make_tables(TURNS, flown).episodes
    assert episodes["loss_of_separation"].to_pylist() == [False, False, True, True, False]
    assert episodes["min_separation_nm"].to_pylist() == least.tolist()


def test_an_episode_sums_its_own_cycles_and_rewards():
    reward = np.array([[1.0, 2.0, 0.5], [-1.0, 0.0, 0.0]], dtype=np.float32)
    flown = recording([4, 9], [[True, True, True], [True, False, False]], reward=reward)
    episodes = make_tables(TURNS, flown).episodes
    assert episodes["scenario"].to_pylist() == [4, 9]
    assert episodes["cycles"].to_pylist() == [3, 1]
    assert episodes["return"].to_pylist() == [3.5, -1.0]


def test_aircraft_are_described_as_they_started():
    """With scenario numbers, not indices: a platform may have failed in those between."""
    start = {
        "route": [[3, 0], [1, 2]],
        "kind": [[1, 0], [0, 1]],
        "level_ticks": [[280.0, 300.0], [310.0, 320.0]],
        "own_navigation": [[True, False], [False, False]],
    }
    exit_level_ticks = np.array([[200.0, 210.0], [220.0, 230.0]], dtype=np.float32) * TICKS_PER_FL
    flown = recording([4, 9], np.ones((2, 1)), start=start, exit_level_ticks=exit_level_ticks)
    rows = make_tables(TURNS, flown, flown_as=lambda kind: f"{kind}/X").aircraft.to_pylist()
    routes = [" ".join(route) for route in TURNS.sector.routes]
    names = ("scenario", "callsign", "type", "route", "entry_fl", "exit_fl", "own_navigation")
    assert [tuple(row[name] for name in names) for row in rows] == [
        (4, "AC1", "AT76/X", routes[3], 280, 200, True),
        (4, "AC2", "B753/X", routes[0], 300, 210, False),
        (9, "AC1", "B753/X", routes[1], 310, 220, False),
        (9, "AC2", "AT76/X", routes[2], 320, 230, False),
    ]


def per_cycle(scenarios, cycles, values):
    """One value per cycle, the same for both aircraft of every scenario."""
    return np.broadcast_to(np.array(values)[None, :, None], (scenarios, cycles, 2))


def test_a_trajectory_ends_with_its_scenario():
    later = {
        "heading_deg": [[[10.0, 20.0], [11.0, 21.0]], [[12.0, 22.0], [13.0, 23.0]]],
        "cleared_heading_deg": per_cycle(2, 2, [90.0, 100.0]),
        "level_ticks": per_cycle(2, 2, [301.0, 302.0]),
        "cleared_level_ticks": per_cycle(2, 2, [310.0, 320.0]),
        "ground_speed_kt": per_cycle(2, 2, [410.0, 420.0]),
        "vertical_speed_ft_min": per_cycle(2, 2, [1000.0, -500.0]),
    }
    flown = recording([4, 9], [[True, True], [True, False]], later=later)
    rows = make_tables(TURNS, flown).trajectories.to_pylist()
    key = ("scenario", "cycle", "time_s", "callsign")
    assert [tuple(row[name] for name in key) for row in rows] == [
        (scenario, cycle, 6 * cycle, callsign)
        for scenario, cycles in ((4, 2), (9, 1))
        for cycle in range(cycles + 1)
        for callsign in ("AC1", "AC2")
    ]
    assert [row["heading_deg"] for row in rows] == [0, 0, 10, 20, 11, 21, 0, 0, 12, 22]
    names = ("cleared_heading_deg", "fl", "cleared_fl", "ground_speed_kt", "vertical_speed_ft_min")
    second = [
        (0.0, 300.0, 300.0, 400.0, 0.0),
        (90.0, 301.0, 310.0, 410.0, 1000.0),
        (100.0, 302.0, 320.0, 420.0, -500.0),
    ]
    assert [tuple(row[name] for name in names) for row in rows[1:6:2]] == second


def test_positions_are_rounded_to_a_centimetre():
    """1e-7 degrees; on the equator, a mile east is 1852 / a radians of longitude."""
    position_nm = np.zeros((1, 1, 2, 2))
    position_nm[..., 0] = 40.0
    rows = make_tables(
        TURNS, recording([0], [[True]], later={"position_nm": position_nm})
    ).trajectories
    assert TURNS.sector.origin == (0.0, 0.0)
    degrees = np.degrees(40.0 * 1852.0 / 6378137.0)
    assert rows["lon"].to_pylist() == [0.0, 0.0, *[round(degrees, 7)] * 2]
    assert rows["lat"].to_pylist() == [0.0] * 4


@pytest.mark.parametrize(
    ("entered", "excursion", "exited", "status"),
    [
        (False, False, False, "before_entry"),
        (True, False, False, "in_sector"),
        (True, True, False, "excursion"),
        (False, True, False, "excursion"),  # never entered
        (True, False, True, "exited"),
        (True, True, True, "exited"),  # returned and crossed its exit
    ],
)
def test_the_status_of_an_aircraft(entered, excursion, exited, status):
    def of_second_aircraft(value):
        return np.array([[[False, False], [False, value]]])

    flags = AircraftStatus(
        entered=of_second_aircraft(entered),
        exited=of_second_aircraft(exited),
        excursion=of_second_aircraft(excursion),
    )
    flown = recording([0], [[True, True]], status=flags)
    rows = make_tables(TURNS, flown).trajectories
    assert rows["status"].to_pylist() == ["before_entry"] * 5 + [status]


def clearances_while_turning(adoption):
    """AC2 of scenario 9 is cleared in cycle 1, while turning: its heading is 200 at issue, 90 after
    the cycle and 200 after the next. The other clearances do not turn."""
    heading = np.zeros((2, 3, 2))
    heading[1, :, 1] = [200.0, 90.0, 200.0]
    cleared = np.zeros((2, 3, 2))
    cleared[1, 1:, 1] = 120.0
    action = np.array([[AC1_RIGHT, 0, AC2_RIGHT], [0, AC2_LEFT, 0]], dtype=np.int32)
    flown = recording(
        [4, 9],
        [[True] * 3] * 2,
        later={"heading_deg": heading, "cleared_heading_deg": cleared},
        action=action,
        instructions=np.array([[1, 0, 3], [0, 7, 0]], dtype=np.int32),
    )
    return make_tables(TURNS, flown, adoption=adoption).clearances.to_pylist()


@pytest.mark.parametrize(("adoption", "direction"), [(SKYSTACK, "right"), (BLUESKY, "left")])
def test_a_turn_is_relative_to_the_heading_at_adoption(adoption, direction):
    """Our simulator adopts after the cycle (090 to 120), BlueSky at once (200 to 120)."""
    assert clearances_while_turning(adoption)[-1] == {
        "scenario": 9,
        "cycle": 1,
        "transmission": 0,
        "callsign": "AC2",
        "kind": "heading",
        "value": 120,
        "direction": direction,
        "instructions": 7,
        "text": f"AC2 turn {direction} heading 120",
    }


def test_clearances_are_in_the_order_of_issue():
    rows = clearances_while_turning(SKYSTACK)
    names = ("scenario", "cycle", "transmission", "callsign", "value", "direction", "instructions")
    assert [tuple(row[name] for name in names) for row in rows[:2]] == [
        (4, 0, 0, "AC1", 0, None, 1),
        (4, 2, 1, "AC2", 0, None, 3),
    ]
    assert [row["text"] for row in rows[:2]] == ["AC1 fly heading 360", "AC2 fly heading 360"]


@pytest.mark.parametrize(("adoption", "direction"), [(SKYSTACK, "climb"), (BLUESKY, "descend")])
def test_a_level_change_is_relative_to_the_level_at_adoption(adoption, direction):
    """Cleared to FL250, AC2 is at FL260 at issue, at FL240 after the cycle, then at FL260."""
    flown = recording(
        [5],
        [[True, True]],
        start={"level_ticks": [[300.0, 260.0]]},
        later={
            "level_ticks": [[[300.0, 240.0], [300.0, 260.0]]],
            "cleared_level_ticks": [[[300.0, 250.0], [300.0, 250.0]]],
        },
        action=np.array([[AC2_DOWN, 0]], dtype=np.int32),
        instructions=np.array([[2, 0]], dtype=np.int32),
    )
    (row,) = make_tables(LEVELS, flown, adoption=adoption).clearances.to_pylist()
    found = {name: row[name] for name in ("callsign", "kind", "value", "direction", "text")}
    assert found == {
        "callsign": "AC2",
        "kind": "level",
        "value": 250,
        "direction": direction,
        "text": f"AC2 {direction} FL250",
    }


def test_writes_tables_with_sector_performance_and_fleet(tmp_path):
    """Each in its own file, in a new folder."""
    folder, flown = tmp_path / "new" / "folder", recording([4], [[True]])
    tables = make_tables(TURNS, flown)
    tabulate(TURNS, iter([flown]), folder)
    names = ["aircraft", "clearances", "episodes", "trajectories"]
    files = sorted(path.name for path in folder.glob("*.parquet"))
    assert files == [f"{name}.parquet" for name in names]
    for name in names:
        table = pq.read_table(folder / f"{name}.parquet")
        assert table.replace_schema_metadata().equals(getattr(tables, name))
        metadata = table.schema.metadata
        assert msgspec.json.decode(metadata[b"sector"])["name"] == "x-plus"
        assert metadata[b"performance"] == TURNS.performance.encode()
        fleet = msgspec.json.decode(metadata[b"fleet"])
        assert [each["type"] for each in fleet] == ["B753", "AT76"]
    tabulate(build_task(NavigationSettings()), iter([flown]), tmp_path / "none")
    assert b"fleet" not in pq.read_schema(tmp_path / "none" / "aircraft.parquet").metadata
