"""Steps with frozen time: each adds an instruction to the stack or flies a cycle."""

import jax
import jax.numpy as jnp
import pytest

from skystack.tasks.registry import build_training_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

from .conftest import REVERSED, STRAIGHT
from .memories import with_fields

NO_OP, LEFT_1, RIGHT_1, LEFT_2, RIGHT_2 = range(5)
BURST_COST_ONLY = RewardSettings(centreline=0.0, damping=0.0, burst=1.0)


@pytest.fixture(scope="module")
def stacked_steps():
    return build_training_task(NavigationSettings(timing="stack", reward=BURST_COST_ONLY))


@pytest.fixture(scope="module")
def step(stacked_steps):
    """The compiled step, for actions as plain integers."""
    program = jax.jit(stacked_steps.step)
    return lambda state, action: program(state, jnp.asarray(action, dtype=jnp.int32))


@pytest.fixture
def start(stacked_steps, traffic_on):
    state = stacked_steps.reset(jax.random.key(0))
    return state._replace(inner=stacked_steps.task.begin(traffic_on(STRAIGHT, REVERSED)))


def run_actions(step, state, actions):
    """The state after the actions, the reward of each, and the last outcome."""
    rewards = []
    for action in actions:
        state, outcome = step(state, action)
        rewards.append(float(outcome.reward[0]))
    return state, rewards, outcome


def test_instructions_take_no_time_and_cost_nothing_yet(step, start):
    """Two left turns, then a cycle that costs one burst."""
    state, rewards, outcome = run_actions(step, start, [LEFT_1, LEFT_1])
    assert float(state.inner.memory.progress.cycles) == 0.0
    assert float(state.inner.traffic.cleared_heading_deg[0]) == 25.0  # 45.19, 35, 25
    assert not bool(outcome.ended)
    assert rewards == [0.0, 0.0]
    state, outcome = step(state, NO_OP)
    assert float(state.inner.memory.progress.cycles) == 1.0
    assert float(outcome.reward[0]) == -1.0
    assert (int(state.stack.action), int(state.stack.instructions)) == (NO_OP, 0)


@pytest.mark.parametrize("other", [RIGHT_1, LEFT_2, RIGHT_2])
def test_an_action_that_ends_the_stack_is_not_executed(step, start, other):
    state, _, _ = run_actions(step, start, [LEFT_1, other])
    assert float(state.inner.memory.progress.cycles) == 1.0
    assert state.inner.memory.counts.instructions.tolist() == [1.0, 0.0]
    # In the next cycle it can start a stack of its own.
    state, _ = step(state, other)
    assert float(state.inner.memory.progress.cycles) == 1.0
    assert float(state.inner.memory.counts.instructions.sum()) == 2.0


def test_a_burst_ends_with_its_cycle(step, start):
    """The same instruction in the next cycle starts a new clearance and costs again."""
    state, rewards, outcome = run_actions(step, start, [LEFT_1, NO_OP, LEFT_1, LEFT_1, NO_OP])
    assert rewards == [0.0, -1.0, 0.0, 0.0, -1.0]
    assert float(outcome.metrics["bursts"]) == 2.0
    assert float(outcome.metrics["instructions"]) == 3.0
    assert float(state.inner.memory.progress.cycles) == 2.0


def test_scenarios_do_not_end_while_time_is_frozen(step, start):
    last_cycle = with_fields(start.inner.memory, cycles=jnp.float32(299.0))
    start = start._replace(inner=start.inner._replace(memory=last_cycle))
    state, frozen = step(start, LEFT_1)
    assert not bool(frozen.ended)
    assert float(frozen.reward[0]) == 0.0
    _, flown = step(state, NO_OP)
    assert bool(flown.ended)


def test_a_started_stack_allows_only_its_own_instruction(stacked_steps, step, start):
    def allowed(state):
        actions = [jnp.asarray(action, dtype=jnp.int32) for action in range(5)]
        return [bool(stacked_steps.may_stack(state, action)) for action in actions]

    assert allowed(start) == [False, True, True, True, True]
    assert allowed(step(start, LEFT_2)[0]) == [False, False, False, True, False]
