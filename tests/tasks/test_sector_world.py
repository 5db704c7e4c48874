"""The world of sector control: births, entries, exits, excursions, and frozen time."""

import jax
import numpy as np
import pytest

from skystack.agents.transmission import Transmission, clearance_of
from skystack.airspace.xplus import x_plus
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World

SLOTS = 16
SIMULATOR = Simulator(x_plus(), performance("constant"), own_navigation=True)
WORLD = World(Flow(SIMULATOR, constant_rate(40.0), slots=SLOTS, candidates=128))
RESET, ADVANCE = jax.jit(WORLD.reset), jax.jit(WORLD.advance)
INSTRUCT = jax.jit(WORLD.instruct)


def flown(cycles, transmit=lambda state: [], seed=1):
    """The states before the cycles, and the cycles."""
    state, states, happened = RESET(jax.random.key(seed)), [], []
    for _ in range(cycles):
        states.append(jax.device_get(state))
        state = INSTRUCT(state, clearance_of(transmit(states[-1]), SLOTS))
        state, cycle = ADVANCE(state)
        happened.append(jax.device_get(cycle))
    return states, happened


def own_navigation(state):
    """Every flight that is not on own navigation is sent direct, to its exit level."""
    ready = (state.arrivals.flight != FREE) & (state.arrivals.held == 0)
    return [
        Transmission(
            slot,
            fix=int(state.progress.next_fix[slot]),
            level_ticks=float(state.plan.exit_level_ticks[slot]),
        )
        for slot in np.flatnonzero(ready & ~state.traffic.own_navigation).tolist()
    ]


@pytest.fixture(scope="module")
def hour():
    return flown(400, own_navigation)


@pytest.mark.slow
def test_every_flight_is_born_once_and_leaves_once(hour):
    _, cycles = hour
    born = [int(c.flight[slot]) for c in cycles for slot in np.flatnonzero(c.born)]
    left = [int(c.flight[slot]) for c in cycles for slot in np.flatnonzero(c.exited | c.excursion)]
    assert born == list(range(len(born)))
    assert len(left) == len(set(left))
    present = {int(flight) for flight in cycles[-1].flight if flight != FREE}
    assert set(born) == set(left) | present
    assert len(left) > 15


@pytest.mark.slow
def test_flights_on_own_navigation_exit_correctly(hour):
    _, cycles = hour
    assert not any(c.excursion.any() for c in cycles)
    assert all(np.array_equal(c.exited, c.exited_correctly) for c in cycles)


@pytest.mark.slow
def test_an_exit_is_where_the_route_leaves_the_area(hour):
    _, cycles = hour
    table = SIMULATOR.sector.route_table
    for cycle in cycles:
        for slot in np.flatnonzero(cycle.exited).tolist():
            route = int(cycle.traffic.route[slot])
            exit_nm = table.fixes_nm[route, table.last_fix[route] - 1]
            assert np.hypot(*(cycle.traffic.position_nm[slot] - exit_nm)) < 1.5
            assert cycle.traffic.level_ticks[slot] == cycle.exit_level_ticks[slot]


@pytest.mark.slow
def test_a_flight_that_is_not_instructed_makes_an_excursion_or_misses_its_level():
    _, cycles = flown(400)
    left = sum(int((c.exited | c.excursion).sum()) for c in cycles)
    assert left > 10
    assert sum(int(c.exited_correctly.sum()) for c in cycles) < left / 4


def test_issuing_clearances_moves_nothing():
    states, _ = flown(60)
    state = states[-1]
    slots = np.flatnonzero((state.arrivals.flight != FREE) & (state.arrivals.held == 0)).tolist()
    told = state
    for slot in slots:
        one = [Transmission(slot, heading_deg=90, level_ticks=ticks(300.0))]
        told = INSTRUCT(told, clearance_of(one, SLOTS))
    told = jax.device_get(told)
    cleared = ("cleared_heading_deg", "cleared_level_ticks", "pending_turn")
    for name in state.traffic._fields:
        same = np.array_equal(getattr(state.traffic, name), getattr(told.traffic, name))
        assert same == (name not in cleared), name
    same = jax.tree.map(np.array_equal, state._replace(traffic=None), told._replace(traffic=None))
    assert all(jax.tree.leaves(same))


def test_newborns_that_are_held_do_not_hear_clearances():
    states, _ = flown(60)
    state = states[-1]
    slot = int(np.argmax(state.arrivals.flight != FREE))
    transmission = clearance_of([Transmission(slot, level_ticks=ticks(205.0))], SLOTS)
    for held in (0, 1):
        arrivals = state.arrivals._replace(held=np.where(np.arange(SLOTS) == slot, held, 0))
        told = INSTRUCT(state._replace(arrivals=arrivals), transmission)
        heard = float(told.traffic.cleared_level_ticks[slot]) == ticks(205.0)
        assert heard == (held == 0)


def test_a_new_flight_in_a_slot_starts_afresh(hour):
    states, cycles = hour
    reused = 0
    seen = set()
    for state, cycle in zip(states, cycles, strict=True):
        for slot in np.flatnonzero(cycle.born).tolist():
            reused += slot in seen
            seen.add(slot)
            assert not cycle.entered[slot]
            np.testing.assert_array_equal(cycle.before_nm[slot], cycle.traffic.position_nm[slot])
            assert state.arrivals.flight[slot] == FREE
    assert reused > 3
