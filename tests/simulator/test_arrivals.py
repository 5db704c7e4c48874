"""Arrivals: who is admitted, where, when, and what happens if it is not possible.

The traffic as a whole is compared with BluebirdDT's in `test_arrival_flows.py`.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import poisson as exact_poisson

from skystack.airspace.xplus import x_plus
from skystack.simulator.arrival_flows import Flow
from skystack.simulator.arrivals import (
    CLEAR_NM,
    FREE,
    MOST_DUE,
    SAME_LEVEL_NM,
    Admission,
    Arrivals,
    Candidates,
    Clock,
    fly,
    poisson,
    release,
)
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import ticks

SIMULATOR = Simulator(x_plus(), performance("constant"), own_navigation=True)
RECORDED = Clock(0.0, recorded=True)


def candidates(*rows):
    """Candidates from (due_s, east, north, level) with headings to the north."""
    due, east, north, level = np.array(rows, dtype=np.float32).T
    n = len(rows)
    levels = jnp.asarray([ticks(float(fl)) for fl in level], dtype=jnp.float32)
    return Candidates(
        due_s=jnp.asarray(due),
        route=jnp.arange(n, dtype=jnp.int32) % 10,
        position_nm=jnp.asarray(np.stack([east, north], axis=1)),
        heading_deg=jnp.zeros(n),
        entry_level_ticks=levels,
        exit_level_ticks=levels + ticks(10.0),
        airspeed_factor=jnp.full(n, 0.9),
        climb_factor=jnp.ones(n),
    )


def world(clock, rows, slots=4, uniforms=(0.5,)):
    """The arrivals, without any flight yet, and the empty traffic."""
    zero, nobody = jnp.int32(0), jnp.zeros(slots, dtype=jnp.int32)
    arrivals = Arrivals(
        flight=nobody + FREE,
        candidate=nobody + FREE,
        entry_level_ticks=jnp.zeros(slots),
        exit_level_ticks=jnp.zeros(slots),
        held=nobody,
        candidates=candidates(*rows),
        uniforms=jnp.asarray(uniforms, dtype=jnp.float32),
        used=zero,
        born=zero,
        waiting=zero,
        refused=zero,
        rate_per_s=jnp.float32(clock.rate_per_s),
        last_birth_s=jnp.float32(0.0),
        cycle=jnp.int32(1),
    )
    return arrivals, Flow(SIMULATOR, clock, slots).empty()


def admit(clock, arrivals, traffic):
    return jax.jit(Admission(SIMULATOR, clock).admit)(arrivals, traffic)


def flown(arrivals, traffic):
    return jax.jit(lambda *state: fly(SIMULATOR, *state))(arrivals, traffic)


def clock_of(due, **settings):
    """A clock with which exactly `due` flights are due if the uniform number is 0.5."""
    middle = {0: 1e-6, 1: 1.2, 2: 2.2, 3: 3.2}[due]
    assert exact_poisson.ppf(0.5, middle) == due
    return Clock(middle / 6.0, max_rate_per_s=10.0, **settings)


@given(st.floats(0.01, 3.0), st.floats(0.001, 0.999))
def test_poisson_numbers_are_the_exact_quantiles(mean, uniform):
    found = int(poisson(jnp.float32(mean), jnp.float32(uniform)))
    low, high = (exact_poisson.ppf(uniform + error, mean) for error in (-1e-5, 1e-5))
    assert min(low, MOST_DUE) <= found <= max(high, 0)


def test_a_recorded_flight_is_born_at_its_time_and_place():
    arrivals, traffic = world(RECORDED, [(12.0, 3.0, -4.0, 310)])
    arrivals, traffic = flown(*admit(RECORDED, arrivals, traffic))  # at 6 s
    assert not traffic.active.any()
    arrivals, traffic = admit(RECORDED, arrivals, traffic)  # at 12 s
    assert arrivals.flight.tolist() == [0, FREE, FREE, FREE]
    assert traffic.active.tolist() == [True, False, False, False]
    assert traffic.position_nm[0].tolist() == [3.0, -4.0]
    assert float(traffic.level_ticks[0]) == float(traffic.cleared_level_ticks[0]) == ticks(310.0)
    assert float(arrivals.exit_level_ticks[0]) == ticks(320.0)
    assert float(traffic.ground_speed_kt[0]) == pytest.approx(360.0)
    assert not bool(traffic.own_navigation[0])


def test_a_newborn_is_held_for_one_cycle_and_then_flies():
    arrivals, traffic = admit(RECORDED, *world(RECORDED, [(0.0, 3.0, -4.0, 310)]))
    arrivals, traffic = flown(arrivals, traffic)
    assert traffic.position_nm[0].tolist() == [3.0, -4.0]
    arrivals, traffic = flown(*admit(RECORDED, arrivals, traffic))
    assert traffic.position_nm[0].tolist() == pytest.approx([3.0, -4.0 + 0.6], abs=1e-3)


def test_flights_take_the_lowest_free_slot_and_keep_it():
    rows = [(0.0, 10.0 * number, 0.0, 200 + 10 * number) for number in range(5)]
    arrivals, traffic = admit(RECORDED, *world(RECORDED, rows, slots=4))
    assert arrivals.flight.tolist() == [0, 1, 2, 3]
    assert int(arrivals.waiting) == 1  # the sector is full: one is held back
    gone = jnp.asarray([False, True, False, False])
    arrivals, traffic = release(arrivals, traffic, gone)
    assert arrivals.flight.tolist() == [0, FREE, 2, 3]
    arrivals, traffic = admit(RECORDED, arrivals, traffic)
    assert arrivals.flight.tolist() == [0, 4, 2, 3]
    assert float(traffic.position_nm[1, 0]) == 40.0
    assert int(arrivals.waiting) == 0


@pytest.mark.parametrize(
    ("distance_nm", "level", "climbs_to", "clear"),
    [
        (CLEAR_NM - 0.1, 300, 300, False),
        (CLEAR_NM - 0.1, 310, 310, True),  # another level
        (CLEAR_NM - 0.1, 280, 320, False),  # climbs through the level
        (CLEAR_NM - 0.1, 296, 296, False),  # rounded outwards to FL290 to FL300
        (CLEAR_NM - 0.1, 289, 289, True),
        (CLEAR_NM + 0.1, 280, 320, True),
        (SAME_LEVEL_NM - 0.1, 300, 300, False),
        (SAME_LEVEL_NM - 0.1, 301, 301, True),  # not exactly the same level
        (SAME_LEVEL_NM + 0.1, 300, 300, True),
    ],
)
def test_a_newborn_keeps_its_distance_from_the_traffic(distance_nm, level, climbs_to, clear):
    """The rule of BluebirdDT, with one candidate at FL300."""
    clock = clock_of(1, attempts=1, unchecked_clearances=True)
    arrivals, traffic = world(clock, [(0.0, 0.0, 0.0, 300)])
    north = distance_nm * float(SIMULATOR.sector.plane.scale(np.array([0.0]))[0])
    traffic = traffic._replace(
        active=jnp.asarray([True, False, False, False]),
        position_nm=traffic.position_nm.at[0, 1].set(north),
        level_ticks=traffic.level_ticks.at[0].set(ticks(level)),
        flown_level_ticks=traffic.flown_level_ticks.at[0].set(ticks(climbs_to)),
    )
    arrivals = arrivals._replace(flight=arrivals.flight.at[0].set(7), born=jnp.int32(8))
    arrivals, _ = admit(clock, arrivals, traffic)
    assert (arrivals.flight.tolist() == [7, 8, FREE, FREE]) == clear
    assert int(arrivals.waiting) == (not clear)


@pytest.mark.parametrize("unchecked", [True, False])
def test_a_flight_is_not_born_where_another_has_just_been_cleared_through_its_level(unchecked):
    """BluebirdDT still admits it: there, the clearance takes effect later."""
    clock = clock_of(1, attempts=1, unchecked_clearances=unchecked)
    arrivals, traffic = world(clock, [(0.0, 0.0, 0.0, 300)])
    traffic = traffic._replace(
        active=jnp.asarray([True, False, False, False]),
        level_ticks=traffic.level_ticks.at[0].set(ticks(290.0)),
        flown_level_ticks=traffic.flown_level_ticks.at[0].set(ticks(290.0)),
        cleared_level_ticks=traffic.cleared_level_ticks.at[0].set(ticks(320.0)),
    )
    arrivals = arrivals._replace(flight=arrivals.flight.at[0].set(7), born=jnp.int32(8))
    arrivals, _ = admit(clock, arrivals, traffic)
    assert (int(arrivals.born) == 9) == unchecked


def test_the_first_clear_candidate_is_born_and_the_others_are_used_up():
    clock = clock_of(1, attempts=3)
    rows = [(0.0, 0.0, 5.0 * number, 300) for number in range(4)] + [(0.0, 0.0, 0.0, 250)]
    arrivals, traffic = admit(clock, *world(clock, rows))
    arrivals = arrivals._replace(cycle=arrivals.cycle + 1)
    arrivals, traffic = admit(clock, arrivals, traffic)  # candidates 1 to 3 are too close
    assert int(arrivals.born) == 1
    assert (int(arrivals.used), int(arrivals.waiting)) == (4, 1)
    arrivals = arrivals._replace(cycle=arrivals.cycle + 1)
    arrivals, traffic = admit(clock, arrivals, traffic)  # the waiting one, and the next
    assert float(traffic.level_ticks[1]) == ticks(250.0)
    assert int(arrivals.candidate[1]) == 4


@pytest.mark.parametrize("unchecked", [True, False])
def test_twins_are_checked_against_each_other_or_not(unchecked):
    clock = clock_of(2, attempts=1, unchecked_twins=unchecked)
    rows = [(0.0, 0.0, 0.0, 300), (0.0, 0.0, 3.0, 300)]
    arrivals, _ = admit(clock, *world(clock, rows))
    assert int(arrivals.born) == (2 if unchecked else 1)
    assert int(arrivals.waiting) == (0 if unchecked else 1)


def test_bluebird_holds_every_second_twin_longer():
    """It replaces newborns while it iterates over their list, and so skips every second one."""
    clock = clock_of(3, attempts=1, unchecked_twins=True, held_cycles=2)
    rows = [(0.0, 20.0 * number, 0.0, 200 + 10 * number) for number in range(3)]
    arrivals, _ = admit(clock, *world(clock, rows))
    assert arrivals.held.tolist()[:3] == [2, 3, 2]


def test_births_that_find_no_candidate_are_given_up_as_in_bluebird():
    clock = clock_of(1, attempts=1, unchecked_twins=True)
    rows = [(0.0, 0.0, 0.0, 300), (0.0, 0.0, 3.0, 300)]
    arrivals, traffic = admit(clock, *world(clock, rows))
    arrivals, _ = admit(clock, arrivals, traffic)
    assert (int(arrivals.refused), int(arrivals.waiting)) == (1, 0)


@pytest.mark.parametrize(("quadratic", "mean"), [(True, 6.0 * 0.12), (False, 6.0 * 0.01)])
def test_the_quadratic_clock_counts_all_seconds_since_the_last_birth(quadratic, mean):
    """After a birth at 0 s, at 72 s."""
    clock = Clock(0.01, quadratic=quadratic)
    below, above = exact_poisson.cdf(0, mean) - 1e-4, exact_poisson.cdf(0, mean) + 1e-4
    for uniform, due in ((below, 0), (above, 1)):
        arrivals, _ = world(clock, [(0.0, 0.0, 0.0, 300)], uniforms=[uniform])
        arrivals = arrivals._replace(cycle=jnp.int32(12))
        assert int(clock.due(arrivals)) == due


@pytest.mark.parametrize(("time_s", "rate"), [(24, 0.005), (30, 0.01), (600, 0.1), (3600, 0.1)])
def test_the_rate_increases_in_steps(time_s, rate):
    clock = Clock(0.005, 0.005, 30.0, 0.1)
    limit = exact_poisson.cdf(0, 6.0 * rate)
    for uniform, due in ((limit - 1e-4, 0), (limit + 1e-4, 1)):
        arrivals, _ = world(clock, [(0.0, 0.0, 0.0, 300)], uniforms=[uniform])
        arrivals = arrivals._replace(cycle=jnp.int32(time_s // 6))
        assert int(clock.due(arrivals)) == due


def test_a_scenario_may_have_another_rate():
    clock = Clock(0.01)
    for factor in (0.5, 1.0, 3.0):
        limit = exact_poisson.cdf(0, 6.0 * 0.01 * factor)
        for uniform, due in ((limit - 1e-4, 0), (limit + 1e-4, 1)):
            arrivals, _ = world(clock, [(0.0, 0.0, 0.0, 300)], uniforms=[uniform])
            arrivals = arrivals._replace(rate_per_s=jnp.float32(0.01 * factor))
            assert int(clock.due(arrivals)) == due


def test_no_births_before_the_first_cycle_and_after_the_end():
    clock = clock_of(3, until_s=60.0)
    arrivals, _ = world(clock, [(0.0, 0.0, 0.0, 300)])
    for cycle, due in ((0, 0), (1, 3), (10, 3), (11, 0)):
        assert int(clock.due(arrivals._replace(cycle=jnp.int32(cycle)))) == due


@pytest.mark.slow
def test_batches_give_the_same_as_single_scenarios():
    clock = Clock(0.05, unchecked_twins=True, quadratic=True)
    flow = Flow(SIMULATOR, clock, slots=16, cycles=50, candidates=64)

    @jax.jit
    def flown_states(keys):
        def step(state, _):
            return fly(SIMULATOR, *flow.admission.admit(*state)), None

        return jax.lax.scan(step, jax.vmap(flow.draw, out_axes=-1)(keys), None, length=30)[0]

    keys = jax.random.split(jax.random.key(3), 3)
    batch = jax.tree.leaves(flown_states(keys))
    for number in range(3):
        alone = jax.tree.leaves(flown_states(keys[number : number + 1]))
        for got, expected in zip(batch, alone, strict=True):
            np.testing.assert_allclose(got[..., number], expected[..., 0], atol=1e-4)
    assert int(flown_states(keys)[0].born.min()) > 2
