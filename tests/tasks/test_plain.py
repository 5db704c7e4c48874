"""A task in plain Python is the task."""

import copy
import gc
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.errors import InputError
from skystack.evaluation.evaluate import policy_task
from skystack.learning.inference import forward, normalise
from skystack.learning.seeds import scenario_key
from skystack.policies.shipped import find_policy
from skystack.stacking import TwoPhase, stack, stack_traced
from skystack.tasks.plain import PlainTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

from .test_conformance import Kept


def test_stacking_in_plain_python_is_stacking_in_a_compiled_program():
    """A shipped policy, in numpy and in JAX, over a whole scenario: the same clearances."""
    policy = find_policy("lateral-best")
    task = policy_task(policy)
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
        assert float(outcome.reward[0]) == float(judged.reward[0])
        assert np.array_equal(plain.observe(seen), observe(state))
    assert spoken > 3


@pytest.fixture(scope="module")
def begun():
    plain = PlainTask(build_task(NavigationSettings()))
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
    task = policy_task(find_policy("lateral"))
    plain = PlainTask(task)
    seen = plain.reset(scenario_key(0, 0))
    said = 0
    while plain.may_stack(seen, 1):
        seen, said = plain.instruct(seen, 1), said + 1
    # Ten degrees more would be half a turn; back to the right is none.
    assert said in (17, 18)
    assert plain.may_stack(seen, 2)
    assert not plain.may_stack(seen, 0)


def test_every_call_is_the_tasks_own():
    task = Kept()
    plain = PlainTask(task)
    key = jax.random.key(4)
    state = task.reset(key)
    seen = plain.reset(key)
    for found in (seen, plain.begin(state)):
        np.testing.assert_allclose(plain.observe(found), task.observe(state), rtol=1e-6)
        np.testing.assert_array_equal(plain.state_of(found).value, state.value)
        assert [plain.may_stack(found, action) for action in (0, 1)] == [False, True]
    halved = plain.instruct(seen, 1)
    np.testing.assert_array_equal(plain.state_of(halved).value, state.value / 2.0)
    for (after, outcome), value in (
        (plain.advance(seen), state.value),
        (plain.step(seen, 1), state.value / 2.0),
    ):
        np.testing.assert_array_equal(plain.state_of(after).value, value)
        np.testing.assert_array_equal(outcome.reward[0], value)
    with pytest.raises(InputError, match=r"action is 2 \(allowed: whole numbers from 0 to 1\)"):
        plain.step(seen, 2)


def test_states_of_many_shapes_and_types_come_back():
    """Packed as one vector of float32, and unpacked in its order."""
    first = (jnp.arange(6.0).reshape(2, 3), jnp.asarray([True, False]), jnp.asarray(7))

    class Mixed(Kept):
        def reset(self, key):
            return first

        def observe(self, state):
            return jnp.zeros(2)

    plain = PlainTask(Mixed())
    back = plain.state_of(plain.begin(first))
    for found, expected in zip(back, first, strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


def test_a_copy_shares_the_programs_of_the_original():
    plain = PlainTask(Kept())
    plain.reset(jax.random.key(0))
    assert copy.copy(plain) is plain
    assert copy.deepcopy({"task": plain})["task"] is plain
    pickled = pickle.dumps(plain)
    assert pickle.loads(pickled) is plain
    assert set(plain._programs) == {"_reset"}
    del plain
    gc.collect()
    first, second = pickle.loads(pickled), pickle.loads(pickled)
    assert first is second
    assert first._programs == {}
