"""Training of sector control with frozen time: rounds of instructions, then a cycle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.tasks.contract import ManyAgents
from skystack.tasks.sector_control import CLIMB, DESCEND, LEFT_10, NONE, RIGHT_10
from skystack.tasks.sector_stacks import ROUNDS, RoundState, SectorStacks
from tests.tasks.sector_traffic import ADVANCE, SLOTS, TASK, after

STACKS = SectorStacks(TASK)
STEP = jax.jit(STACKS.step)


@pytest.fixture(scope="module")
def start():
    inner = after(100)
    return RoundState(inner, TASK.active(inner), jnp.int32(0))


def actions(**by_slot):
    chosen = jnp.full(SLOTS, NONE, dtype=jnp.int32)
    for slot, action in by_slot.items():
        chosen = chosen.at[int(slot[1:])].set(action)
    return chosen


def two_flights(state):
    levels = np.asarray(state.inner.world.traffic.cleared_level_ticks)
    middle = (levels >= 6000 * 240) & (levels <= 6000 * 360)
    return np.flatnonzero(np.asarray(state.decides) & middle)[:2].tolist()


@pytest.mark.slow
def test_time_is_frozen_while_flights_are_instructed(start):
    one, other = two_flights(start)
    state, outcome = STEP(start, actions(**{f"s{one}": LEFT_10, f"s{other}": CLIMB}))
    assert np.flatnonzero(state.decides).tolist() == sorted([one, other])
    assert int(state.inner.world.arrivals.cycle) == int(start.inner.world.arrivals.cycle)
    np.testing.assert_array_equal(
        state.inner.world.traffic.position_nm, start.inner.world.traffic.position_nm
    )
    assert not np.asarray(outcome.reward).any()
    assert float(outcome.steps) == 0.0
    waits = np.asarray(STACKS.waiting(state))
    np.testing.assert_array_equal(waits, np.asarray(start.decides) & ~np.asarray(state.decides))


@pytest.mark.slow
def test_a_flight_that_waits_is_asked_again_in_the_next_cycle(start):
    one, other = two_flights(start)
    state, _ = STEP(start, actions(**{f"s{one}": LEFT_10}))
    state, _ = STEP(state, actions(**{f"s{one}": LEFT_10, f"s{other}": LEFT_10}))
    headings = np.asarray(state.inner.world.traffic.cleared_heading_deg)
    before = np.asarray(start.inner.world.traffic.cleared_heading_deg)
    assert (before[one] - headings[one]) % 360 == pytest.approx(20.0, abs=0.5)
    assert headings[other] == before[other]
    state, outcome = STEP(state, actions())
    assert float(outcome.steps) == 1.0
    assert int(state.inner.world.arrivals.cycle) == int(start.inner.world.arrivals.cycle) + 1
    np.testing.assert_array_equal(state.decides, TASK.active(state.inner))
    assert not np.asarray(state.inner.burst).any()


@pytest.mark.slow
def test_a_stack_costs_one_transmission_and_its_instructions(start):
    weights, (one, _) = TASK.reward, two_flights(start)
    state, _ = STEP(start, actions(**{f"s{one}": CLIMB}))
    state, _ = STEP(state, actions(**{f"s{one}": DESCEND}))
    assert float(state.inner.world.traffic.cleared_level_ticks[one]) == float(
        start.inner.world.traffic.cleared_level_ticks[one]
    )
    _, outcome = STEP(state, actions())
    _, untouched = STEP(start, actions())
    paid = np.asarray(untouched.reward - outcome.reward)
    # It is cleared back to its old level, so nothing else differs.
    expected = np.zeros(SLOTS)
    expected[one] = weights.transmission + 2.0 * weights.instruction
    np.testing.assert_allclose(paid, expected, atol=1e-5)


@pytest.mark.slow
def test_no_stack_is_endless(start):
    one, _ = two_flights(start)
    state, steps = start, 0
    while int(state.inner.world.arrivals.cycle) == int(start.inner.world.arrivals.cycle):
        state, _ = STEP(state, actions(**{f"s{one}": LEFT_10}))
        steps += 1
    assert steps == ROUNDS + 1


@pytest.mark.slow
def test_a_cycle_without_instructions_is_that_of_the_task(start):
    state, outcome = STEP(start, actions())
    expected, expected_outcome = ADVANCE(start.inner)
    for name in ("world", "outlook", "level_gap_ticks", "exit_nm", "totals"):
        found = getattr(state.inner, name)
        for one, two in zip(*map(jax.tree.leaves, (found, getattr(expected, name))), strict=True):
            np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(outcome.reward, expected_outcome.reward)


@pytest.mark.slow
def test_a_round_and_a_cycle_are_also_separate_functions(start):
    one, other = two_flights(start)
    told = actions(**{f"s{one}": DESCEND, f"s{other}": RIGHT_10})
    stepped, separate = STEP(start, told)[0], jax.jit(STACKS.instruct)(start, told)
    np.testing.assert_array_equal(stepped.decides, separate.decides)
    chosen = np.asarray(stepped.decides)
    for name in ("time_s", "neighbour"):
        found, expected = (getattr(each.inner.outlook, name) for each in (stepped, separate))
        np.testing.assert_array_equal(np.asarray(found)[:, chosen], np.asarray(expected)[:, chosen])
    flown, _ = jax.jit(STACKS.advance)(start)
    np.testing.assert_array_equal(
        flown.inner.world.traffic.position_nm,
        STEP(start, actions())[0].inner.world.traffic.position_nm,
    )


def test_it_has_agents_that_share_a_policy():
    assert isinstance(STACKS, ManyAgents)
