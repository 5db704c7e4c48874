"""The clearances of the safety net."""

import jax
import numpy as np
import pytest

from skystack.agents.safety_net import (
    ALERT_S,
    AREA_ALERT_S,
    GAIN_S,
    alerts,
    lasts_s,
    way_out,
)
from skystack.agents.transmission import Transmission
from skystack.simulator.traffic import ticks
from skystack.stacking import NO_OP
from skystack.tasks.outlook import CHANGES_FL, CLEARED, TURNS_DEG, WAYS, no_outlook
from skystack.tasks.prediction import HORIZON_S
from tests.tasks.sector_traffic import TASK, after

SLOT = 0


@pytest.fixture(scope="module")
def world():
    """A flight that is cleared to heading 040 and FL300, and must leave at FL330."""
    world = jax.device_get(after(60, action=NO_OP).world)
    heading = np.array(world.traffic.cleared_heading_deg)
    level, exit_level = np.array(world.traffic.level_ticks), np.array(world.plan.exit_level_ticks)
    heading[SLOT], level[SLOT], exit_level[SLOT] = 40.0, ticks(300.0), ticks(330.0)
    return world._replace(
        traffic=world.traffic._replace(cleared_heading_deg=heading, cleared_level_ticks=level),
        arrivals=world.arrivals._replace(exit_level_ticks=exit_level),
    )


def answer(world, **times):
    """The answer if separation lasts a minute, or after some clearances other times."""
    time_s = np.full(len(WAYS), 60.0, dtype=np.float32)
    for way, time in times.items():
        time_s[WAYS.index(way.replace("_", " "))] = time
    return way_out(TASK.sector, world, SLOT, time_s)


def predicted(time_s=HORIZON_S, leaves_s=HORIZON_S):
    """The outlook of two flights; the second has neither a conflict nor an exit elsewhere."""
    outlook = jax.tree.map(np.array, no_outlook((2,)))
    outlook.time_s[CLEARED, 0], outlook.leaves_s[CLEARED, 0] = time_s, leaves_s
    return outlook


def no_alert(**times):
    return not alerts(predicted(**times)).any()


def test_alerts_are_of_losses_within_two_minutes_and_of_departures_within_one():
    assert no_alert()
    assert no_alert(time_s=ALERT_S, leaves_s=AREA_ALERT_S)
    assert alerts(predicted(time_s=ALERT_S - 1.0)).tolist() == [True, False]
    assert alerts(predicted(leaves_s=AREA_ALERT_S - 1.0)).tolist() == [True, False]


def test_a_clearance_lasts_until_the_first_of_both():
    outlook = predicted(time_s=100.0, leaves_s=45.0)
    lasts = lasts_s(outlook)[:, 0]
    assert lasts[CLEARED] == 45.0
    assert lasts[WAYS.index("level +10")] == 45.0  # the same path
    assert lasts[WAYS.index("direct")] == lasts[WAYS.index("turn +10")] == HORIZON_S
    outlook.leaves_s[WAYS.index("direct"), 0] = 60.0
    assert lasts_s(outlook)[WAYS.index("direct, exit level"), 0] == 60.0


def test_it_says_nothing_that_hardly_helps(world):
    assert answer(world) is None
    assert answer(world, direct=60.0 + GAIN_S - 1.0) is None
    assert answer(world, direct=60.0 + GAIN_S) is not None


def test_the_clearance_that_lasts_longest_is_chosen(world):
    fix = int(world.progress.next_fix[SLOT])
    assert answer(world, direct=400.0, exit_level=360.0) == Transmission(SLOT, fix=fix)


@pytest.mark.parametrize("change", CHANGES_FL)
def test_every_change_of_level_is_that_of_the_outlook(world, change):
    low, high = TASK.sector.levels_fl
    level = ticks(min(max(300.0 + change, low), high))
    found = answer(world, **{f"level {change:+.0f}": HORIZON_S})
    assert found == Transmission(SLOT, level_ticks=level)


def test_levels_stay_within_the_sector(world):
    high = world._replace(
        traffic=world.traffic._replace(
            cleared_level_ticks=np.full_like(world.traffic.cleared_level_ticks, ticks(390.0))
        )
    )
    found = answer(high, **{"level +40": HORIZON_S})
    assert found.level_ticks == ticks(float(TASK.sector.levels_fl[1]))


@pytest.mark.parametrize("turn", TURNS_DEG)
def test_every_turn_is_that_of_the_outlook(world, turn):
    found = answer(world, **{f"turn {turn:+.0f}": HORIZON_S})
    assert found == Transmission(SLOT, heading_deg=int(40 + turn) % 360)


def test_of_equal_clearances_the_one_with_the_smallest_detour_is_chosen(world):
    """Levels near the exit level, then direct, then small turns."""
    long = dict.fromkeys(["level -10", "level +20", "level +70", "turn +10", "direct"], HORIZON_S)
    assert answer(world, **long).level_ticks == ticks(320.0)
    assert answer(world, **long, **{"exit level": HORIZON_S}).level_ticks == ticks(330.0)
    turns = {"turn -20": HORIZON_S, "turn +10": HORIZON_S}
    assert answer(world, **turns).heading_deg == 50
    assert answer(world, **turns, direct=HORIZON_S).fix == int(world.progress.next_fix[SLOT])


def test_cleared_is_the_first_way():
    assert WAYS[CLEARED] == "cleared"
