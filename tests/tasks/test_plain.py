"""`PlainTask` behaves exactly like the task that it wraps."""

import copy
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

from .test_conformance import HalvingTask


@pytest.mark.slow
def test_stacks_like_a_compiled_program():
    """A shipped policy issues the same clearances in numpy and in JAX, over a whole scenario."""
    policy = find_policy("lateral-best")
    task = policy_task(policy)
    plain = PlainTask(task)
    assert isinstance(plain, TwoPhase)

    def decide(observation):
        return forward(policy.actor, normalise(policy.normaliser, observation)).argmax()

    def traced(observation, _):
        return decide(observation).astype("int32")

    compiled = jax.jit(lambda state, key: stack_traced(task, traced, state, key))
    advance, observe, key = jax.jit(task.advance), jax.jit(task.observe), scenario_key(0, 3)
    plain_state, state = plain.reset(key), jax.jit(task.reset)(key)
    instructions = 0
    for _ in range(120):
        plain_state, issued = stack(plain, decide, plain_state)
        state, expected = compiled(state, key)
        assert (issued.action, issued.instructions) == (expected.action, expected.instructions)
        instructions += int(issued.instructions)
        np.testing.assert_allclose(
            plain.state_of(plain_state).traffic.cleared_heading_deg,
            state.traffic.cleared_heading_deg,
        )
        unpacked = plain.state_of(plain_state)
        assert [leaf.dtype for leaf in jax.tree.leaves(unpacked)] == [
            leaf.dtype for leaf in jax.tree.leaves(state)
        ]
        plain_state, outcome = plain.advance(plain_state)
        state, expected_outcome = advance(state)
        assert float(outcome.reward[0]) == float(expected_outcome.reward[0])
        assert np.array_equal(plain.observe(plain_state), observe(state))
    assert instructions > 3


@pytest.fixture(scope="module")
def started():
    plain = PlainTask(build_task(NavigationSettings()))
    return plain, plain.reset(scenario_key(0, 0))


@pytest.mark.slow
@pytest.mark.parametrize("answer", [5, -1, 2.0, None, "left", np.float32(np.nan), np.array([1, 2])])
def test_refuses_an_action_outside_the_table(started, answer):
    plain, plain_state = started
    for method in (plain.may_stack, plain.instruct, plain.step):
        with pytest.raises(InputError, match="allowed: whole numbers from 0 to 4"):
            method(plain_state, answer)
    with pytest.raises(InputError, match="allowed: whole numbers from 0 to 4"):
        stack(plain, lambda observation: answer, plain_state)


def test_may_stack_answers_for_every_action():
    task = policy_task(find_policy("lateral"))
    plain = PlainTask(task)
    plain_state = plain.reset(scenario_key(0, 0))
    turns = 0
    while plain.may_stack(plain_state, 1):
        plain_state, turns = plain.instruct(plain_state, 1), turns + 1
    # Ten degrees more would exceed half a turn; a turn back to the right does not.
    assert turns in (17, 18)
    assert plain.may_stack(plain_state, 2)
    assert not plain.may_stack(plain_state, 0)


def test_every_method_agrees_with_the_task():
    task = HalvingTask()
    plain = PlainTask(task)
    key = jax.random.key(4)
    state = task.reset(key)
    plain_state = plain.reset(key)
    for found in (plain_state, plain.begin(state)):
        np.testing.assert_allclose(plain.observe(found), task.observe(state), rtol=1e-6)
        np.testing.assert_array_equal(plain.state_of(found).value, state.value)
        assert [plain.may_stack(found, action) for action in (0, 1)] == [False, True]
    halved = plain.instruct(plain_state, 1)
    np.testing.assert_array_equal(plain.state_of(halved).value, state.value / 2.0)
    for (after, outcome), value in (
        (plain.advance(plain_state), state.value),
        (plain.step(plain_state, 1), state.value / 2.0),
    ):
        np.testing.assert_array_equal(plain.state_of(after).value, value)
        np.testing.assert_array_equal(outcome.reward[0], value)
    with pytest.raises(InputError, match=r"action is 2 \(allowed: whole numbers from 0 to 1\)"):
        plain.step(plain_state, 2)


@pytest.mark.slow
@pytest.mark.parametrize("task", [HalvingTask(), build_task(NavigationSettings())])
def test_every_instruction_of_a_burst_is_that_of_the_task(task):
    """The instruction may change, and a state may be used again."""
    plain, key = PlainTask(task), jax.random.key(4)
    instruct, view = jax.jit(task.instruct), jax.jit(jax.vmap(task.may_stack, (None, 0)))
    plain_state, state = plain.reset(key), jax.jit(task.reset)(key)
    numbers = range(len(task.action_names))
    for action in (1, 1, 1, 0, 1, 0, 0, 1):
        again, plain_state = plain_state, plain.instruct(plain_state, action)
        state = instruct(state, jnp.int32(action))
        for found in (plain_state, plain.instruct(again, action)):
            jax.tree.map(_assert_equal, plain.state_of(found), state)
            np.testing.assert_allclose(plain.observe(found), task.observe(state), rtol=1e-6)
            allowed = [plain.may_stack(found, number) for number in numbers]
            assert allowed == view(state, jnp.asarray(numbers)).tolist()


def _assert_equal(found, expected):
    numbers = (
        jax.random.key_data if jnp.issubdtype(found.dtype, jax.dtypes.prng_key) else np.asarray
    )
    np.testing.assert_array_equal(numbers(found), numbers(expected))


def test_a_changed_observation_changes_no_state():
    """A policy may work in the array that it gets."""
    plain = PlainTask(HalvingTask())
    plain_state = plain.reset(jax.random.key(4))
    for found in (plain_state, plain.instruct(plain_state, 1)):
        first = plain.observe(found)
        expected = first.copy()
        first[:] = 7.0
        np.testing.assert_array_equal(plain.observe(found), expected)


def test_unpacks_states_of_mixed_shapes_and_types():
    """States are packed into one vector. Tasks with random steps keep a key in their state."""
    first = (
        jnp.arange(6.0).reshape(2, 3),
        jnp.asarray([True, False]),
        jnp.asarray(2**30 + 1),
        jax.random.PRNGKey(2**31 + 1),
        jax.random.key(3),
    )

    class Mixed(HalvingTask):
        def reset(self, key):
            return first

        def observe(self, state):
            return jnp.zeros(2)

    plain = PlainTask(Mixed())
    unpacked = plain.state_of(plain.begin(first))
    for found, expected in zip(unpacked, first, strict=True):
        assert found.dtype == expected.dtype
        _assert_equal(found, expected)


def test_copies_are_the_original_and_pickles_have_programs_of_their_own():
    """Unless the task is a value."""
    plain = PlainTask(HalvingTask())
    plain.reset(jax.random.key(0))
    assert copy.copy(plain) is plain
    assert copy.deepcopy({"task": plain})["task"] is plain
    assert set(plain._programs) == {"_reset"}
    unpickled = pickle.loads(pickle.dumps(plain))
    assert unpickled._programs == {}
