"""Predicted departures from the area against flights of the simulator, in two sectors."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.sectors import sector_named
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.performance import performance
from skystack.simulator.simulator import CYCLE_S, Simulator
from skystack.simulator.traffic import DIRECT, SHORTEST, Clearance
from skystack.tasks.leaving import LEAVING_S
from skystack.tasks.outlook import CLEARED, PATH_OF_WAY, TURNS_DEG, WAYS
from skystack.tasks.prediction import HORIZON_S, TIMES_S
from skystack.tasks.sector_world import World

SLOTS = 32
SECTORS = ["x-plus", "merge"]
INTERVAL_S = 15
STARTS = range(60, 460, 20)


@cache
def world(sector):
    simulator = Simulator(sector_named(sector), performance("constant"), own_navigation=True)
    return World(Flow(simulator, constant_rate(150.0), slots=SLOTS, candidates=256))


@cache
def programs(sector):
    """The compiled reset, instruction, cycle and outlook."""
    of = world(sector)
    return tuple(map(jax.jit, (of.reset, of.instruct, of.advance, of.look_ahead)))


def clearance(state, turn, heading):
    return Clearance(
        turn=jnp.full_like(state.traffic.pending_turn, turn),
        heading_deg=jnp.round(heading) % 360.0,
        changes_level=jnp.zeros_like(state.traffic.active),
        level_ticks=state.traffic.cleared_level_ticks,
        fix=state.progress.next_fix,
    )


@cache
def states(sector, own):
    """States of traffic that holds its headings, or is always sent direct."""
    reset, instruct, advance, _ = programs(sector)
    state, found = reset(jax.random.key(3)), []
    for cycle in range(max(STARTS) + 1):
        if cycle in STARTS:
            found.append(state)
        if own:
            state = instruct(state, clearance(state, DIRECT, state.traffic.heading_deg))
        state, _ = advance(state)
    return found


def leaving_times(sector, state):
    """When each flight makes an excursion, and when it is gone for any reason; else infinite."""
    _, _, advance, _ = programs(sector)
    flight = np.asarray(state.arrivals.flight)
    excursion_s, gone_s = np.full(SLOTS, np.inf), np.full(SLOTS, np.inf)
    for cycle in range(LEAVING_S // CYCLE_S):
        state, flown = advance(state)
        same = np.asarray(flown.flight) == flight
        time_s = (cycle + 1) * CYCLE_S
        for times, happened in (
            (excursion_s, flown.excursion),
            (gone_s, flown.excursion | flown.exited),
        ):
            first = same & np.asarray(happened) & np.isinf(times)
            times[first] = time_s
    return excursion_s, gone_s


def compared(sector, state, told, path):
    """Predicted and flown times of the flights that have entered."""
    look_ahead = programs(sector)[3]
    predicted = np.asarray(look_ahead(state).leaves_s)[path]
    excursion_s, gone_s = leaving_times(sector, told)
    chosen = np.asarray(state.traffic.active & state.progress.entered)
    return predicted[chosen], excursion_s[chosen], gone_s[chosen]


def check(pairs, delay_s=0):
    """Flights leave in the predicted interval, or later by up to a cycle and a delay. Flights that
    stay are not predicted to leave."""
    predicted, excursion_s, gone_s = (np.concatenate(values) for values in zip(*pairs, strict=True))
    leaves = np.isfinite(excursion_s)
    assert leaves.sum() > 5
    late_s = excursion_s[leaves] - predicted[leaves]
    assert np.mean((late_s >= 0) & (late_s <= INTERVAL_S + CYCLE_S + delay_s)) > 0.95
    stays = np.isinf(gone_s)
    assert stays.sum() > 20
    assert np.mean(predicted[stays] >= LEAVING_S - INTERVAL_S) > 0.97


@pytest.mark.slow
@pytest.mark.parametrize("sector", SECTORS)
def test_flights_on_headings_leave_when_predicted(sector):
    check([compared(sector, state, state, CLEARED) for state in states(sector, own=False)])


@pytest.mark.slow
@pytest.mark.parametrize("sector", SECTORS)
@pytest.mark.parametrize("turn_deg", [-90.0, 90.0])
def test_flights_leave_when_predicted_after_a_turn(sector, turn_deg):
    instruct, path = programs(sector)[1], 2 + TURNS_DEG.index(turn_deg)
    pairs = []
    for state in states(sector, own=True):
        heading = state.traffic.cleared_heading_deg + turn_deg
        told = instruct(state, clearance(state, SHORTEST, heading))
        pairs.append(compared(sector, state, told, path))
    # A turn begins a cycle after the clearance, which moves the place where the area is left.
    check(pairs, delay_s=2 * CYCLE_S)


@pytest.mark.slow
@pytest.mark.parametrize("sector", SECTORS)
def test_flights_that_leave_through_their_exits_are_not_predicted_to_leave_elsewhere(sector):
    pairs = [compared(sector, state, state, CLEARED) for state in states(sector, own=True)]
    predicted, excursion_s, gone_s = (np.concatenate(values) for values in zip(*pairs, strict=True))
    exits = np.isfinite(gone_s) & np.isinf(excursion_s)
    assert exits.sum() > 5
    assert (predicted[exits] == HORIZON_S).all()


def test_flights_that_have_not_entered_are_not_predicted_to_leave():
    state = states("x-plus", own=False)[0]
    outside = np.asarray(state.traffic.active & ~state.progress.entered)
    assert outside.sum() > 0
    leaves_s = np.asarray(programs("x-plus")[3](state).leaves_s)
    assert (leaves_s[:, outside] == HORIZON_S).all()


def test_paths_of_the_clearances():
    path = dict(zip(WAYS, PATH_OF_WAY.tolist(), strict=True))
    assert (path["cleared"], path["direct"], path["turn -90"], path["turn +90"]) == (0, 1, 2, 11)
    assert path["exit level"] == path["level +10"] == 0
    assert path["direct, exit level"] == 1
    assert TIMES_S[1] == INTERVAL_S
