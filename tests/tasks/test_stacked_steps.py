"""Steps with time frozen: one more instruction of a stack, or else one cycle."""

import jax
import jax.numpy as jnp
import pytest

from skystack.tasks.registry import build_training_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

from .conftest import BACK, STRAIGHT
from .memories import changed

NONE, LEFT_1, RIGHT_1, LEFT_2, RIGHT_2 = range(5)
PRICES = RewardSettings(centreline=0.0, damping=0.0, burst=1.0)


@pytest.fixture(scope="module")
def steps():
    return build_training_task(NavigationSettings(timing="stack", reward=PRICES))


@pytest.fixture(scope="module")
def step(steps):
    """Compiled, and of a plain number."""
    program = jax.jit(steps.step)
    return lambda state, action: program(state, jnp.asarray(action, dtype=jnp.int32))


@pytest.fixture
def begun(steps, traffic_on):
    state = steps.reset(jax.random.key(0))
    return state._replace(inner=steps.task.begin(traffic_on(STRAIGHT, BACK)))


def after(step, state, actions):
    """The state after actions, what each was paid, and the last outcome."""
    paid = []
    for action in actions:
        state, outcome = step(state, action)
        paid.append(float(outcome.reward[0]))
    return state, paid, outcome


def test_an_instruction_takes_no_time_and_costs_nothing_yet(step, begun):
    """Two turns to the left, then a cycle, which costs the burst: one."""
    state, paid, outcome = after(step, begun, [LEFT_1, LEFT_1])
    assert float(state.inner.memory.progress.cycles) == 0.0
    assert float(state.inner.traffic.cleared_heading_deg[0]) == 25.0  # 45.19, 35, 25
    assert not bool(outcome.ended)
    assert paid == [0.0, 0.0]
    state, outcome = step(state, NONE)
    assert float(state.inner.memory.progress.cycles) == 1.0
    assert float(outcome.reward[0]) == -1.0
    assert (int(state.stack.action), int(state.stack.instructions)) == (NONE, 0)


@pytest.mark.parametrize("other", [RIGHT_1, LEFT_2, RIGHT_2])
def test_what_would_end_the_stack_is_not_executed(step, begun, other):
    state, _, _ = after(step, begun, [LEFT_1, other])
    assert float(state.inner.memory.progress.cycles) == 1.0
    assert state.inner.memory.counts.instructions.tolist() == [1.0, 0.0]
    # In the next cycle it may begin one of its own.
    state, _ = step(state, other)
    assert float(state.inner.memory.progress.cycles) == 1.0
    assert float(state.inner.memory.counts.instructions.sum()) == 2.0


def test_a_burst_ends_with_its_cycle(step, begun):
    """The same instruction in the next cycle is a new clearance, and is paid for again."""
    state, paid, outcome = after(step, begun, [LEFT_1, NONE, LEFT_1, LEFT_1, NONE])
    assert paid == [0.0, -1.0, 0.0, 0.0, -1.0]
    assert float(outcome.metrics["bursts"]) == 2.0
    assert float(outcome.metrics["instructions"]) == 3.0
    assert float(state.inner.memory.progress.cycles) == 2.0


def test_no_scenario_ends_while_time_is_frozen(step, begun):
    late = changed(begun.inner.memory, cycles=jnp.float32(299.0))
    begun = begun._replace(inner=begun.inner._replace(memory=late))
    state, told = step(begun, LEFT_1)
    assert not bool(told.ended)
    assert float(told.reward[0]) == 0.0
    _, flown = step(state, NONE)
    assert bool(flown.ended)


def test_only_what_continues_the_stack_may_be_stacked(steps, step, begun):
    def allowed(state):
        every = [jnp.asarray(action, dtype=jnp.int32) for action in range(5)]
        return [bool(steps.may_stack(state, action)) for action in every]

    assert allowed(begun) == [False, True, True, True, True]
    assert allowed(step(begun, LEFT_2)[0]) == [False, False, False, True, False]
