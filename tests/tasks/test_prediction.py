"""Predicted paths and levels against flights of the simulator."""

from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.agents.sector_rules import OwnNavigation
from skystack.agents.transmission import clearance_of
from skystack.airspace.sectors import sector_named
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.performance import performance
from skystack.simulator.simulator import CYCLE_S, Simulator, instruct
from skystack.simulator.traffic import DIRECT, NO_TURN, SHORTEST, Clearance, ticks
from skystack.tasks.prediction import (
    LEAVES_LATE_S,
    TIMES_S,
    path_along_route,
    path_as_cleared,
    path_on_heading,
    predicted_level,
)
from skystack.tasks.sector_world import World
from tests.tasks.sector_traffic import SIMULATOR, SLOTS, after

SECTOR = SIMULATOR.sector
ADVANCE, INSTRUCT = jax.jit(SIMULATOR.advance), jax.jit(instruct)
AS_CLEARED = jax.jit(partial(path_as_cleared, SECTOR))
ON_HEADING, ALONG_ROUTE = (
    jax.jit(partial(path, SECTOR)) for path in (path_on_heading, path_along_route)
)
LEVEL = jax.jit(partial(predicted_level, SIMULATOR))
UNTIL_S = 300
LAST_CYCLES = 10


def flown(traffic):
    """Positions and levels every six seconds."""
    rows = []
    for _ in range(UNTIL_S // CYCLE_S + 1):
        rows.append((np.asarray(traffic.position_nm), np.asarray(traffic.level_ticks)))
        traffic = ADVANCE(traffic)
    return rows


def errors_nm(path, rows, chosen):
    """The distance of the prediction from the flight, `[times, flights]`."""
    errors = []
    for index, time in enumerate(TIMES_S):
        if time > UNTIL_S:
            break
        at = np.interp(time / CYCLE_S, range(len(rows)), range(len(rows)))
        low = int(at)
        high = min(low + 1, len(rows) - 1)
        position = rows[low][0] + (at - low) * (rows[high][0] - rows[low][0])
        east, north = path.east_nm[index] - position[:, 0], path.north_nm[index] - position[:, 1]
        errors.append(np.hypot(east, north)[chosen])
    return np.array(errors)


@pytest.fixture(scope="module")
def state():
    return after(120)


@pytest.mark.slow
def test_a_heading_is_flown_as_predicted(state):
    traffic = state.world.traffic
    level = level_flight(traffic)
    heading = jnp.round(traffic.heading_deg + 50.0) % 360.0
    cleared = INSTRUCT(
        level,
        Clearance(
            turn=jnp.full_like(traffic.pending_turn, SHORTEST),
            heading_deg=heading,
            changes_level=jnp.zeros_like(traffic.active),
            level_ticks=traffic.level_ticks,
        ),
    )
    adopted = ADVANCE(cleared)
    path = ON_HEADING(adopted, heading)
    active = np.asarray(traffic.active)
    assert active.sum() > 8
    assert errors_nm(path, flown(adopted), active).max() < 0.05
    as_cleared = AS_CLEARED(adopted)
    np.testing.assert_allclose(
        np.asarray(as_cleared.east_nm)[:, active], np.asarray(path.east_nm)[:, active], atol=1e-4
    )


def level_flight(traffic):
    kept = traffic._replace(flown_level_ticks=traffic.level_ticks)
    return kept._replace(cleared_level_ticks=traffic.level_ticks)


@pytest.mark.slow
def test_a_route_is_flown_as_predicted(state):
    """Also by flights that are in a turn at a fix."""
    traffic = level_flight(state.world.traffic)
    chosen = np.asarray(traffic.active & traffic.own_navigation)
    assert chosen.sum() > 6
    path = AS_CLEARED(traffic)
    inside = np.asarray(path.until_s)[chosen] > UNTIL_S  # on the way to the exit all the time
    errors = errors_nm(path, flown(traffic), chosen)[:, inside]
    assert errors.shape[1] > 3
    assert errors.max() < 0.5
    assert np.median(errors) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn_deg", "farther_nm", "most_nm"),
    [
        (-80.0, 18.0, 1.2),
        (-30.0, 18.0, 1.2),
        (30.0, 18.0, 1.2),
        (80.0, 18.0, 1.2),
        # Small turns are flown with little bank, on circles so large that some never end.
        (-10.0, 8.0, 1.2),
        (5.0, 8.0, 1.2),
    ],
)
def test_a_turn_direct_to_a_fix_is_flown_as_predicted(state, turn_deg, farther_nm, most_nm):
    traffic = level_flight(state.world.traffic)
    heading = (traffic.heading_deg + turn_deg) % 360.0
    off = traffic._replace(
        heading_deg=heading,
        flown_heading_deg=heading,
        cleared_heading_deg=heading,
        turn_deg=jnp.zeros_like(heading),
        turn_radius_nm=jnp.zeros_like(heading),
        own_navigation=jnp.zeros_like(traffic.active),
    )
    fix = state.world.progress.next_fix
    direct = Clearance(
        turn=jnp.full_like(traffic.pending_turn, DIRECT),
        heading_deg=heading,
        changes_level=jnp.zeros_like(traffic.active),
        level_ticks=traffic.level_ticks,
        fix=fix,
    )
    adopted = ADVANCE(INSTRUCT(off, direct))
    path = AS_CLEARED(adopted)
    to_fix = SECTOR.route_table.fixes_nm[np.asarray(traffic.route), np.asarray(fix)]
    far = np.hypot(*(to_fix - np.asarray(traffic.position_nm)).T) > farther_nm
    chosen = np.asarray(traffic.active) & far & (np.asarray(path.until_s) > UNTIL_S)
    assert chosen.sum() > 3
    errors = errors_nm(path, flown(adopted), chosen)
    assert errors.max() < most_nm
    assert np.median(errors) < 0.3


@pytest.mark.slow
def test_levels_are_predicted_exactly(state):
    traffic = state.world.traffic
    goal = jnp.where(jnp.arange(traffic.active.shape[0]) % 2 == 0, ticks(260.0), ticks(390.0))
    changed = traffic._replace(cleared_level_ticks=goal, flown_level_ticks=goal)
    changed = changed._replace(pending_turn=jnp.full_like(traffic.pending_turn, NO_TURN))
    predicted = np.asarray(LEVEL(changed, goal))
    rows, active = flown(changed), np.asarray(traffic.active)
    for index, time in enumerate(TIMES_S):
        if time <= UNTIL_S and time % CYCLE_S == 0:
            np.testing.assert_array_equal(
                predicted[index, active], rows[time // CYCLE_S][1][active]
            )


@pytest.mark.slow
def test_the_predicted_flight_leaves_at_its_exit_fix(state):
    traffic = state.world.traffic
    table = SECTOR.route_table
    continues = jnp.ones_like(traffic.active)
    path = ALONG_ROUTE(traffic, traffic.next_fix, continues)
    for slot in np.flatnonzero(np.asarray(traffic.active)).tolist():
        route, fix = int(traffic.route[slot]), int(traffic.next_fix[slot])
        points = [np.asarray(traffic.position_nm[slot])]
        points += list(table.fixes_nm[route, fix : table.last_fix[route]])
        # The arcs of turns are shorter than the corners, or longer than the straight way.
        length = sum(np.hypot(*(b - a)) for a, b in pairwise(points))
        speed = float(traffic.ground_speed_kt[slot]) / 3600.0
        expected = length / speed + LEAVES_LATE_S
        assert float(path.until_s[slot]) == pytest.approx(expected, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x-plus", "crossing"])
def test_no_flight_is_predicted_to_be_gone_before_it_has_left(name):
    """Also after it has passed its exit fix, or begun the turn there."""
    simulator = Simulator(sector_named(name), performance("constant"), own_navigation=True)
    world = World(Flow(simulator, constant_rate(120.0), slots=SLOTS, candidates=64))
    agent, predict = OwnNavigation(False, per_cycle=SLOTS), jax.jit(partial(_gone_s, world.sector))
    reset, told, advance = jax.jit(world.reset), jax.jit(world.instruct), jax.jit(world.advance)
    state = jax.device_get(reset(jax.random.key(1)))
    predicted, late = [], []
    for _ in range(300):
        sent = agent.transmit(state)
        state = told(state, clearance_of(sent, SLOTS)) if sent else state
        predicted.append(np.asarray(predict(state.traffic)))
        flight = np.asarray(state.arrivals.flight)
        state, cycle = jax.device_get(advance(state))
        for slot in np.flatnonzero(cycle.exited & (cycle.flight == flight)).tolist():
            recent = predicted[: -LAST_CYCLES - 1 : -1]
            late += [
                (float(gone_s[slot]) - CYCLE_S * (back + 1), flight[slot])
                for back, gone_s in enumerate(recent)
            ]
    assert len({flight for _, flight in late}) > 10
    assert all(0.0 < seconds <= LEAVES_LATE_S for seconds, _ in late)


def _gone_s(sector, traffic):
    return path_as_cleared(sector, traffic).until_s


@pytest.mark.slow
def test_a_flight_that_has_missed_its_exit_is_not_gone(state):
    """It flies on to the last fix of its route."""
    traffic, table = state.world.traffic, SECTOR.route_table
    route = np.asarray(traffic.route)
    last = table.last_fix[route]
    exit_nm, last_nm = (table.fixes_nm[route, fix].astype(np.float64) for fix in (last - 1, last))
    leg = last_nm - exit_nm
    beyond = exit_nm + leg / np.hypot(*leg.T)[:, None] * 2.0
    missed = traffic._replace(
        position_nm=jnp.asarray(beyond, dtype=jnp.float32),
        next_fix=jnp.asarray(last, dtype=jnp.int32),
        own_navigation=jnp.ones_like(traffic.own_navigation),
        pending_turn=jnp.full_like(traffic.pending_turn, NO_TURN),
    )
    speed = np.asarray(traffic.ground_speed_kt) / 3600.0
    active = np.asarray(traffic.active)
    expected = (np.hypot(*leg.T) - 2.0) / np.where(active, speed, 1.0) + LEAVES_LATE_S
    until_s = np.asarray(AS_CLEARED(missed).until_s)
    np.testing.assert_allclose(until_s[active], expected[active], rtol=0.01)
