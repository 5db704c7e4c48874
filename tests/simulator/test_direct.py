"""Clearances direct to a fix, and factors of speed and climb.

Whole flights are compared with BluebirdDT's in `tests/platforms/test_bluebird.py`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.geometry import bearing
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import instruct
from skystack.simulator.traffic import DIRECT, NO_TURN, SHORTEST, Clearance

from .flights import MODELS, flights

ROUTE = 0
FIX = 2


def traffic(model="constant", own_navigation=False, heading_deg=90.0):
    """One aircraft near the start of its route, to be cleared to fixes."""
    simulation = flights(model, own_navigation=True)
    fixes_nm = simulation.simulator.sector.route_table.fixes_nm[ROUTE]
    start = simulation.start(fixes_nm[None, 0], heading_deg, route=[ROUTE])
    return start._replace(
        own_navigation=jnp.asarray([own_navigation]), cleared_fix=jnp.zeros(1, dtype=jnp.int32)
    )


def cleared(turn, heading_deg=0.0, fix=0):
    return Clearance(
        jnp.asarray([turn], dtype=jnp.int32),
        jnp.asarray([heading_deg], dtype=jnp.float32),
        jnp.asarray([False]),
        jnp.zeros(1),
        jnp.asarray([fix], dtype=jnp.int32),
    )


advance = jax.jit(flights("constant", own_navigation=True).simulator.advance)


def test_direct_to_a_fix_is_adopted_one_cycle_later():
    start = traffic()
    told = instruct(start, cleared(DIRECT, fix=FIX))
    physical = set(start._fields) - {"cleared_fix", "pending_turn"}
    for name in physical:
        before, after = getattr(start, name), getattr(told, name)
        assert before is after is None or np.array_equal(before, after), name
    flown = advance(told)
    assert bool(flown.own_navigation[0])
    assert int(flown.next_fix[0]) == FIX
    assert float(flown.heading_deg[0]) == 90.0  # the cycle was still flown as before
    assert float(advance(flown).heading_deg[0]) != 90.0


def test_flies_straight_to_the_fix():
    state = instruct(traffic(heading_deg=300.0), cleared(DIRECT, fix=FIX))
    target = flights("constant").simulator.sector.route_table.fixes_nm[ROUTE, FIX]
    nearest = np.inf
    for row in range(100):
        state = advance(state)
        nearest = min(nearest, float(np.hypot(*(state.position_nm[0] - target))))
        if row >= 30 and int(state.next_fix[0]) == FIX:  # the turn is complete
            course = float(bearing(jnp.asarray(target)[None] - state.position_nm)[0]) % 360.0
            assert float(state.heading_deg[0]) == pytest.approx(course, abs=0.2)
    assert nearest < 4.0  # it flies by the fix
    assert int(state.next_fix[0]) > FIX


@pytest.mark.parametrize("last", ["heading", "fix"])
def test_the_later_of_a_heading_and_a_fix_applies(last):
    heading, fix = cleared(SHORTEST, 120.0), cleared(DIRECT, fix=FIX)
    order = (fix, heading) if last == "heading" else (heading, fix)
    state = traffic()
    for clearance in order:
        state = instruct(state, clearance)
    state = advance(state)
    assert bool(state.own_navigation[0]) == (last == "fix")
    if last == "heading":
        assert float(state.flown_heading_deg[0]) == 120.0


def test_without_a_new_clearance_nothing_changes():
    state = instruct(traffic(own_navigation=True), cleared(NO_TURN, fix=FIX))
    assert int(state.cleared_fix[0]) == 0
    assert int(advance(state).next_fix[0]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_factors_multiply_speeds_and_rates(model):
    simulation = flights(model)
    plain = simulation.start(np.zeros((3, 2)), 90.0, 300.0)
    climbing = plain._replace(flown_level_ticks=plain.level_ticks + 50.0 * TICKS_PER_FL)
    factor = np.array([1.0, 1.03, 0.875], dtype=np.float32)
    faster = climbing._replace(
        airspeed_factor=jnp.asarray(factor), climb_factor=jnp.asarray([1.0, 1.1, 0.9])
    )
    one, other = simulation.fly(climbing, 1), simulation.fly(faster, 1)
    for name in ("position_nm", "level_ticks", "ground_speed_kt"):  # a factor of 1 changes no bit
        np.testing.assert_array_equal(getattr(one, name)[:, 0], getattr(other, name)[:, 0])
    rate = np.round(one.vertical_speed_ft_min[1] * np.array([1.0, 1.1, 0.9]))
    np.testing.assert_array_equal(other.vertical_speed_ft_min[1], rate)
    if model == "constant":
        expected = np.sqrt((400.0 * factor) ** 2 - (rate * 0.3048 * 60 / 1852) ** 2)
        np.testing.assert_allclose(other.ground_speed_kt[1], expected, rtol=1e-6)
    np.testing.assert_array_equal(other.level_ticks[1] % 1.0, 0.0)  # whole ticks do not drift
