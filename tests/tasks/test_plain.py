"""A task in plain Python is the task."""

import jax
import numpy as np
import pytest

from skystack.catalogue import find_policy
from skystack.errors import InputError
from skystack.evaluation.judge import task_of
from skystack.learning.inference import forward, normalise
from skystack.seeds import scenario_key
from skystack.stacking import TwoPhase, stack, stack_traced
from skystack.tasks.build import build_task
from skystack.tasks.plain import PlainTask
from skystack.tasks.settings import TaskSettings


def test_stacking_in_plain_python_is_stacking_in_a_compiled_program():
    """A shipped policy, in numpy and in JAX, over a whole scenario: the same clearances."""
    policy = find_policy("lateral-best")
    task = task_of(policy)
    plain = PlainTask(task)
    assert isinstance(plain, TwoPhase)

    def decide(seen):
        return forward(policy.actor, normalise(policy.normaliser, seen)).argmax()

    def traced(seen, _):
        return decide(seen).astype("int32")

    compiled = jax.jit(lambda state, key: stack_traced(task, traced, state, key))
    advance, observe, key = jax.jit(task.advance), jax.jit(task.observe), scenario_key(0, 3)
    seen, state = plain.reset(key), jax.jit(task.reset)(key)
    spoken = 0
    for _ in range(120):
        seen, issued = stack(plain, decide, seen)
        state, expected = compiled(state, key)
        assert (issued.action, issued.instructions) == (expected.action, expected.instructions)
        spoken += int(issued.instructions)
        np.testing.assert_allclose(
            plain.state_of(seen).traffic.cleared_heading_deg, state.traffic.cleared_heading_deg
        )
        own = plain.state_of(seen)
        assert [leaf.dtype for leaf in jax.tree.leaves(own)] == [
            leaf.dtype for leaf in jax.tree.leaves(state)
        ]
        seen, outcome = plain.advance(seen)
        state, judged = advance(state)
        assert float(outcome.reward) == float(judged.reward)
        assert np.array_equal(plain.observe(seen), observe(state))
    assert spoken > 3


@pytest.fixture(scope="module")
def begun():
    plain = PlainTask(build_task(TaskSettings()))
    return plain, plain.reset(scenario_key(0, 0))


@pytest.mark.parametrize("answer", [5, -1, 2.0, None, "left", np.float32(np.nan), np.array([1, 2])])
def test_an_action_outside_the_table_is_named(begun, answer):
    plain, seen = begun
    for use in (plain.may_stack, plain.instruct, plain.step):
        with pytest.raises(InputError, match="allowed: whole numbers from 0 to 4"):
            use(seen, answer)
    with pytest.raises(InputError, match="allowed: whole numbers from 0 to 4"):
        stack(plain, lambda observation: answer, seen)


def test_whether_something_may_be_said_is_known_for_every_instruction():
    task = task_of(find_policy("lateral"))
    plain = PlainTask(task)
    seen = plain.reset(scenario_key(0, 0))
    said = 0
    while plain.may_stack(seen, 1):
        seen, said = plain.instruct(seen, 1), said + 1
    # Ten degrees more would be half a turn; back to the right is none.
    assert said in (17, 18)
    assert plain.may_stack(seen, 2)
    assert not plain.may_stack(seen, 0)
