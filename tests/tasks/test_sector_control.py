"""The task `sector-control`: instructions, transmissions, ends, rewards, observations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.traffic import DIRECT, SHORTEST, ticks
from skystack.tasks.conformance import check_task
from skystack.tasks.contract import ManyAgents, TrafficTask
from skystack.tasks.sector_control import (
    ACTIONS,
    CLIMB,
    DESCEND,
    LEFT_10,
    NONE,
    RIGHT_10,
    TO_FIX,
    _lost,
)
from skystack.tasks.sector_observation import NAMES
from tests.tasks.sector_traffic import (
    ADVANCE,
    FLY,
    INSTRUCT,
    OBSERVE,
    RESET,
    SIMULATOR,
    SLOTS,
    STEP,
    TASK,
    after,
)

PHYSICAL = (
    "position_nm", "heading_deg", "level_ticks", "ground_speed_kt", "vertical_speed_ft_min",
    "flown_heading_deg", "flown_level_ticks", "turn_deg", "own_navigation", "next_fix",
)  # fmt: skip


@pytest.fixture(scope="module")
def state():
    return after(100)


def told(state, action, slot=None):
    """The state after one action, to one flight or to all."""
    actions = jnp.full(SLOTS, action if slot is None else NONE, dtype=jnp.int32)
    return INSTRUCT(state, actions if slot is None else actions.at[slot].set(action))


def hearing(state):
    return np.flatnonzero(np.asarray(TASK.active(state)))


@pytest.mark.slow
def test_it_follows_the_contract():
    assert isinstance(TASK, ManyAgents)
    assert not isinstance(TASK, TrafficTask)
    check_task(TASK, steps=20)


@pytest.mark.slow
@pytest.mark.parametrize("action", range(len(ACTIONS)))
def test_an_instruction_moves_nothing(state, action):
    after_it = told(state, action).world.traffic
    for name in PHYSICAL:
        np.testing.assert_array_equal(
            getattr(state.world.traffic, name), getattr(after_it, name), err_msg=name
        )
    assert int(told(state, action).world.arrivals.cycle) == int(state.world.arrivals.cycle)


@pytest.mark.slow
def test_the_instructions_of_a_stack_add_up(state):
    slot = hearing(state)[0]
    stacked = state
    for action in (LEFT_10, LEFT_10, LEFT_10, DESCEND, DESCEND):
        stacked = told(stacked, action, slot)
    old, new = state.world.traffic, stacked.world.traffic
    heading = (np.round(float(old.cleared_heading_deg[slot])) - 30.0) % 360.0
    assert float(new.cleared_heading_deg[slot]) == heading
    assert int(new.pending_turn[slot]) == SHORTEST
    lower = float(old.cleared_level_ticks[slot]) - 2 * ticks(10.0)
    assert float(new.cleared_level_ticks[slot]) == max(lower, ticks(200.0))
    others = np.arange(SLOTS) != slot
    for name in ("cleared_heading_deg", "cleared_level_ticks", "pending_turn"):
        np.testing.assert_array_equal(
            np.asarray(getattr(old, name))[others], np.asarray(getattr(new, name))[others]
        )


def test_what_may_be_stacked(state):
    traffic = state.world.traffic
    lowest, highest = (ticks(float(level)) for level in SIMULATOR.sector.levels_fl)
    levels = jnp.full(SLOTS, highest).at[0].set(lowest)
    at_limits = state._replace(
        world=state.world._replace(traffic=traffic._replace(cleared_level_ticks=levels))
    )
    for action, expected in ((CLIMB, levels < highest), (DESCEND, levels > lowest)):
        allowed = TASK.may_stack(at_limits, jnp.full(SLOTS, action, dtype=jnp.int32))
        np.testing.assert_array_equal(allowed, TASK.active(state) & expected)
    nothing = TASK.may_stack(state, jnp.full(SLOTS, NONE, dtype=jnp.int32))
    assert not np.asarray(nothing).any()
    slot = hearing(state)[0]
    direct = told(told(state, RIGHT_10, slot), TO_FIX, slot)
    assert int(direct.world.traffic.pending_turn[slot]) == DIRECT
    again = TASK.may_stack(direct, jnp.full(SLOTS, TO_FIX, dtype=jnp.int32))
    assert not bool(again[slot])


def test_instructions_in_consecutive_cycles_are_one_transmission(state):
    slot = hearing(state)[0]
    totals, now = [], state
    for action in (LEFT_10, LEFT_10, NONE, LEFT_10, NONE, NONE):
        actions = jnp.full(SLOTS, NONE, dtype=jnp.int32).at[slot].set(action)
        now, _ = STEP(now, actions)
        totals.append(float(now.totals.transmissions - state.totals.transmissions))
    assert totals == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]


@pytest.mark.slow
def test_a_transmission_costs_its_price_once(state):
    slot = hearing(state)[0]
    _, quiet = ADVANCE(state)
    once, first = ADVANCE(told(state, LEFT_10, slot))
    price = float(quiet.reward[slot] - first.reward[slot])
    weights = TASK.reward
    # The heading may change the predicted loss, too.
    before, after_it = (
        weights.predicted * max(0.0, 1.0 - float(each.outlook.time_s[0, slot]) / 300.0)
        for each in (ADVANCE(state)[0], once)
    )
    assert price == pytest.approx(
        weights.transmission + weights.instruction + after_it - before, abs=1e-4
    )
    others = np.delete(np.arange(SLOTS), slot)
    same = np.asarray(quiet.reward)[others] == np.asarray(first.reward)[others]
    assert same.mean() > 0.8  # others pay if they are in conflict with the turned flight


def test_flights_that_leave_are_terminated_and_the_end_truncates_the_others():
    state, left, ended = after(1), 0, None
    nothing = jnp.full(SLOTS, TO_FIX, dtype=jnp.int32)
    for _ in range(TASK.cycles):
        before = np.asarray(TASK.active(state))
        state, outcome = STEP(state, nothing)
        terminated, truncated = np.asarray(outcome.terminated), np.asarray(outcome.truncated)
        assert not terminated[~before].any()
        assert not (terminated & truncated).any()
        assert (np.asarray(outcome.reward)[~before] == 0.0).all()
        left += int(terminated.sum())
        if bool(outcome.ended):
            ended = truncated | terminated
            break
    assert left == int(state.totals.left) > 5
    assert ended is not None
    assert ended.all()


def test_observations_are_within_range_and_zero_without_a_flight(state):
    observed = np.asarray(OBSERVE(state))
    assert observed.shape == (len(NAMES), SLOTS)
    assert ((observed >= 0.0) & (observed <= 1.0)).all()
    assert (observed[:, ~np.asarray(state.world.traffic.active)] == 0.0).all()
    rows = dict(zip(NAMES, observed, strict=True))
    slot = hearing(state)[0]
    plan, traffic = state.world.plan, state.world.traffic
    gap = float(traffic.cleared_level_ticks[slot] - plan.exit_level_ticks[slot]) / ticks(1.0)
    assert rows["fl_sx"][slot] == pytest.approx((gap + 200.0) / 400.0, abs=1e-6)


@pytest.mark.slow
def test_a_batch_is_computed_like_single_scenarios():
    keys = jax.random.split(jax.random.key(3), 2)
    many = jax.jit(jax.vmap(TASK.reset, out_axes=-1))(keys)
    one = [RESET(key) for key in keys]
    action = jnp.full(SLOTS, TO_FIX, dtype=jnp.int32)
    step = jax.jit(TASK.step)
    for _ in range(40):
        many, together = step(many, jnp.stack([action, action], axis=-1))
        results = [STEP(state, action) for state in one]
        one = [state for state, _ in results]
    alone = np.stack([np.asarray(outcome.reward) for _, outcome in results], axis=-1)
    np.testing.assert_allclose(np.asarray(together.reward), alone, atol=2e-3)
    np.testing.assert_array_equal(
        np.asarray(many.world.arrivals.flight),
        np.stack([np.asarray(state.world.arrivals.flight) for state in one], axis=-1),
    )


@pytest.mark.slow
def test_losses_are_those_of_a_search_over_all_pairs(state):
    _, cycle = FLY(state.world)
    position = np.asarray(cycle.traffic.position_nm).copy()
    before = np.asarray(cycle.before_nm).copy()
    slots = np.flatnonzero(np.asarray(cycle.traffic.active))[:3]
    position[slots[1]] = position[slots[0]] + 3.0
    before[slots[1]] = before[slots[0]] + 3.0
    position[slots[2]] = position[slots[0]] + 100.0
    before[slots[2]] = before[slots[0]] + 100.0
    level = jnp.full(SLOTS, ticks(300.0))
    active = jnp.zeros(SLOTS, dtype=bool).at[slots].set(True)
    moved = cycle._replace(
        before_nm=jnp.asarray(before),
        before_level_ticks=level,
        traffic=cycle.traffic._replace(
            position_nm=jnp.asarray(position), level_ticks=level, active=active
        ),
    )
    assert np.flatnonzero(np.asarray(_lost(SIMULATOR.sector, moved))).tolist() == sorted(
        slots[:2].tolist()
    )
    apart = moved._replace(
        before_level_ticks=level.at[slots[1]].add(ticks(10.0)),
        traffic=moved.traffic._replace(level_ticks=level.at[slots[1]].add(ticks(10.0))),
    )
    assert not np.asarray(_lost(SIMULATOR.sector, apart)).any()
