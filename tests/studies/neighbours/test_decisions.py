"""Decisions of several cycles, against the same actions one by one; and the heads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.tasks.batch import reset_many
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from studies.neighbours.decisions import (
    Decisions,
    conditional_head,
    held,
    independent_head,
    options,
    repeated,
    repetitions,
)

GAMMA = 0.9


@pytest.fixture(scope="module")
def task():
    return build_task(NavigationSettings(cycles=200))


@pytest.fixture(scope="module")
def step(task):
    return jax.jit(task.step)


def equal(first, second):
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_a_decision_equals_its_actions_flown_one_by_one(task, step):
    """In a batch with decisions of other lengths."""
    decisions = ((0,), (1, 1, 1), (3, 0, 4, 4, 0, 2))
    start = reset_many(task, jax.random.key(3), len(decisions))
    wrapped = Decisions(task, decisions, GAMMA)
    state, outcome = jax.jit(wrapped.step)(start, jnp.arange(3))
    assert outcome.steps.tolist() == [1.0, 3.0, 6.0]
    for index, actions in enumerate(decisions):
        one, reward = jax.tree.map(lambda leaf, index=index: leaf[..., index], start), 0.0
        for cycle, action in enumerate(actions):
            one, last = step(one, jnp.asarray(action))
            reward += GAMMA**cycle * float(last.reward[0])
        mine = jax.tree.map(lambda leaf, index=index: leaf[..., index], state)
        equal(mine, one)
        assert float(outcome.reward[0, index]) == pytest.approx(reward, rel=1e-5)
        assert {name: float(values[index]) for name, values in outcome.metrics.items()} == {
            name: pytest.approx(float(value)) for name, value in last.metrics.items()
        }
    assert wrapped.action_names[1] == ", ".join([task.action_names[1]] * 3)


def test_a_decision_ends_with_the_scenario(task):
    """The time limit is reached in the third of ten cycles, and no cycle is flown after it."""
    wrapped = Decisions(task, ((0,) * 10,), GAMMA)
    state = task.reset(jax.random.key(0))
    early = state.memory.progress._replace(cycles=jnp.asarray(197.0))
    state = state._replace(memory=state.memory._replace(progress=early))
    after, outcome = jax.jit(wrapped.step)(state, jnp.asarray(0))
    assert (float(outcome.steps), bool(outcome.ended)) == (3.0, True)
    assert float(after.memory.progress.cycles) == 200.0


def test_the_decisions_of_each_method():
    """With the actions none, left and right."""
    assert repeated(3, 2) == ((0, 0), (1, 1), (2, 2))
    assert held(3, 3) == ((0, 0, 0), (1, 0, 0), (2, 0, 0))
    assert repetitions(2, 3) == ((0,), (0, 0), (0, 0, 0), (1,), (1, 1), (1, 1, 1))
    assert options(3, 2) == ((0,), (1,), (1, 1), (2,), (2, 2))


def test_heads_have_the_probabilities_of_the_papers():
    """P(a, d | s) is P(a) P(d) for FiGAR, and P(a) P(d | a) for TempoRL."""
    rng = np.random.default_rng(0)
    softmax = lambda values: np.exp(values) / np.exp(values).sum(-1, keepdims=True)  # noqa: E731
    head = independent_head(3, 4)
    outputs = rng.normal(size=(head.outputs, 2)).astype(np.float32)
    found = softmax(np.asarray(head.logits(outputs)).T)
    for sample in range(2):
        action, cycles = softmax(outputs[:3, sample]), softmax(outputs[3:, sample])
        np.testing.assert_allclose(found[sample], np.outer(action, cycles).ravel(), rtol=1e-5)
    head = conditional_head(3, 4)
    outputs = rng.normal(size=(head.outputs, 2)).astype(np.float32)
    found = softmax(np.asarray(head.logits(outputs)).T)
    for sample in range(2):
        action = softmax(outputs[:3, sample])
        cycles = softmax(outputs[3:, sample].reshape(3, 4))
        expected = action[:, None] * cycles
        np.testing.assert_allclose(found[sample], expected.ravel(), rtol=1e-5)
    assert (independent_head(3, 4).outputs, head.outputs) == (7, 15)
