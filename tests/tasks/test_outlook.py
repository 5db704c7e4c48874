"""The outlook against a search second by second."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.traffic import start, ticks
from skystack.tasks.outlook import (
    CLEARED,
    MARGIN_NM,
    WAYS,
    look_ahead,
    look_ahead_for,
    time_to_loss_as_cleared,
)
from skystack.tasks.prediction import HORIZON_S, TIMES_S
from skystack.tasks.urgency import NEIGHBOURS
from tests.tasks.sector_traffic import SIMULATOR, SLOTS, after

SECTOR = SIMULATOR.sector
LOOK_AHEAD = jax.jit(partial(look_ahead, SIMULATOR))
BELOW_NM = SECTOR.separation_nm + MARGIN_NM


def straight(state):
    """All flights hold their headings, half of them changing level."""
    traffic = state.world.traffic
    goal = np.asarray(traffic.level_ticks).copy()
    goal[::2] = ticks(300.0)
    changed = traffic._replace(
        own_navigation=np.zeros_like(traffic.own_navigation),
        cleared_heading_deg=traffic.heading_deg,
        flown_heading_deg=traffic.heading_deg,
        turn_deg=np.zeros_like(traffic.turn_deg),
        cleared_level_ticks=goal,
        flown_level_ticks=goal,
    )
    return jax.tree.map(jnp.asarray, changed)


def second_by_second(traffic):
    """The time to the first loss of each flight, or the horizon."""
    active = np.flatnonzero(np.asarray(traffic.active))
    heading = np.radians(np.asarray(traffic.heading_deg))
    speed = np.asarray(traffic.ground_speed_kt) / 3600.0
    step = speed[:, None] * np.stack([np.sin(heading), np.cos(heading)], axis=1)
    position = np.asarray(traffic.position_nm, dtype=np.float64)
    level = np.asarray(traffic.level_ticks, dtype=np.float64)
    to_go = np.asarray(traffic.cleared_level_ticks) - level
    found = np.full(len(level), HORIZON_S)
    for second in range(int(HORIZON_S)):
        at = position + second * step
        now = level + np.clip(to_go, -2000.0 * second, 2000.0 * second)
        for number, one in enumerate(active):
            for other in active[number + 1 :]:
                lost = np.hypot(*(at[one] - at[other])) < BELOW_NM
                if lost and abs(now[one] - now[other]) < ticks(10.0):
                    found[[one, other]] = np.minimum(found[[one, other]], second)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_time_to_loss_is_that_of_a_search_second_by_second(seed):
    state = after(120, seed)
    traffic = straight(state)
    plan = state.world.plan
    outlook = LOOK_AHEAD(traffic, traffic.next_fix, plan.exit_level_ticks, traffic.active)
    predicted, searched = np.asarray(outlook.time_s[0]), second_by_second(traffic)
    active = np.asarray(traffic.active)
    assert (searched[active] < HORIZON_S).any()
    # The predicted time is the beginning of the interval in which the loss falls. Within an
    # interval, vertical and horizontal separation may be lost at different times.
    bounds = np.array(TIMES_S, dtype=float)
    interval = bounds[np.searchsorted(bounds, searched, side="right") - 1]
    assert (predicted[active] <= searched[active]).all()
    assert np.mean(predicted[active] == interval[active]) > 0.8


@pytest.mark.slow
def test_a_turn_away_or_another_level_ends_a_conflict():
    one, other = 0, 1
    mask = np.zeros(SLOTS, dtype=bool)
    mask[[one, other]] = True
    position = np.zeros((SLOTS, 2), dtype=np.float32)
    position[other] = (0.0, 40.0)
    heading = np.zeros(SLOTS, dtype=np.float32)
    heading[other] = 180.0
    level, nobody = jnp.full(SLOTS, ticks(300.0)), jnp.zeros(SLOTS, dtype=jnp.int32)
    traffic = start(
        jnp.asarray(position),
        jnp.asarray(heading),
        level,
        nobody,
        jnp.full(SLOTS, 360.0),
        jnp.zeros(SLOTS, dtype=bool),
    )._replace(active=jnp.asarray(mask), cleared_fix=nobody)
    outlook = LOOK_AHEAD(traffic, traffic.next_fix, level, traffic.active)
    time = dict(zip(WAYS, np.asarray(outlook.time_s)[:, one], strict=True))
    # Head-on at 720 kt: 6 NM, with the margin, are left after 34 NM, 170 s.
    assert time["cleared"] == 160.0
    assert time["exit level"] == 160.0
    assert time["turn +40"] == HORIZON_S
    assert time["turn -40"] == HORIZON_S
    assert time["level +20"] == HORIZON_S
    assert time["level -10"] == HORIZON_S
    assert int(outlook.neighbour[0, one]) == other
    assert float(outlook.neighbour_time_s[0, one]) == 160.0
    assert (np.asarray(outlook.time_s)[:, ~mask] == HORIZON_S).all()


@pytest.mark.slow
def test_every_neighbour_is_another_flight():
    state = after(120, 1)
    neighbour, urgency = np.asarray(state.outlook.neighbour), np.asarray(state.outlook.urgency)
    active = np.asarray(state.world.traffic.active)
    assert neighbour.shape == (NEIGHBOURS, SLOTS)
    exists = np.asarray(state.outlook.exists) & active[None]
    assert exists.sum(axis=0).max() == min(NEIGHBOURS, active.sum() - 1)
    assert active[neighbour[exists]].all()
    assert (neighbour != np.arange(SLOTS)[None])[exists].all()
    assert (np.diff(urgency, axis=0) >= 0.0).all()


@pytest.mark.slow
def test_the_time_to_loss_as_cleared_is_that_of_the_full_outlook():
    """For a batch of two scenarios."""
    states = [after(120, seed).world for seed in (0, 1)]
    two = jax.tree.map(lambda *values: jnp.stack(values, axis=-1), *states)
    looks = (
        two.traffic,
        two.progress.next_fix,
        two.plan.exit_level_ticks,
        two.progress.entered,
        0.0,
    )
    every = look_ahead(SIMULATOR, *looks).time_s[CLEARED]
    alone = time_to_loss_as_cleared(SIMULATOR, *looks)
    assert (np.asarray(alone) < HORIZON_S).any()
    np.testing.assert_array_equal(alone, every)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_the_outlook_of_one_flight_is_its_column(seed):
    state = after(120, seed)
    progress, plan = state.world.progress, state.world.plan
    traffic = state.world.traffic
    looks = (traffic, progress.next_fix, plan.exit_level_ticks, progress.entered)
    everyone = LOOK_AHEAD(*looks)
    one = jax.jit(partial(look_ahead_for, SIMULATOR))
    for slot in np.flatnonzero(np.asarray(traffic.active))[:6]:
        own = one(jnp.int32(slot), *looks)
        np.testing.assert_array_equal(own.time_s[:, 0], everyone.time_s[:, slot])
        np.testing.assert_array_equal(own.leaves_s[:, 0], everyone.leaves_s[:, slot])
        exists = np.asarray(own.exists)[:, 0]
        np.testing.assert_array_equal(exists, np.asarray(everyone.exists)[:, slot])
        for name in ("neighbour", "neighbour_time_s"):
            values = (getattr(each, name) for each in (own, everyone))
            found, expected = (np.asarray(each) for each in values)
            np.testing.assert_array_equal(found[exists, 0], expected[exists, slot])
