"""Collecting: actions are drawn by their probability, and transitions are those of the task."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning import inference, ppo
from skystack.learning.collection import collect, draw, sample_actions
from skystack.tasks.batch import OneByOne
from tests.learning.test_ppo import COLLECTING, SignTask


def test_samples_actions_by_their_probability():
    """Each uniform number yields the action whose interval of [0, 1) contains it."""
    probabilities = np.array([0.1, 0.0, 0.5, 0.15, 0.25])
    uniform = (np.arange(1000) + 0.5) / 1000
    logits = np.log(np.maximum(probabilities, 1e-30), dtype=np.float32)
    drawn = sample_actions(
        jnp.broadcast_to(jnp.asarray(logits)[:, None], (5, 1000)), jnp.float32(uniform)
    )
    assert np.bincount(drawn, minlength=5).tolist() == [100, 0, 500, 150, 250]
    assert (np.diff(drawn) >= 0).all()


@pytest.fixture(scope="module")
def collected():
    """The learner before (with partial returns) and after, the transitions, and the episodes."""
    task = OneByOne(SignTask())
    learner = ppo.init(task, COLLECTING, jax.random.key(0))
    learner = learner._replace(returns=jnp.asarray([10.0, 20.0, 30.0]))
    after, steps, episodes = collect(task, COLLECTING, learner, draw(task, COLLECTING, learner))
    return learner, after, jax.tree.map(np.asarray, steps), episodes


@pytest.mark.slow
def test_collects_the_transitions_of_the_task(collected):
    """Scenarios have five steps: in twelve steps two end, and each is followed by a new one."""
    before, after, steps, _ = collected
    seen, final = steps.observation[:, 0], steps.final_observation[:, 0]
    assert seen.shape == (12, 3)
    np.testing.assert_array_equal(seen[0], before.observations[0])
    np.testing.assert_allclose(final, np.mod(seen * 7.3 + 0.31, 1.0), atol=2e-6)
    ends = np.arange(12) % 5 == 4
    np.testing.assert_array_equal(steps.terminated, np.repeat(ends[:, None], 3, axis=1))
    assert not np.any(steps.truncated)
    np.testing.assert_array_equal(seen[1:][~ends[:-1]], final[:-1][~ends[:-1]])
    np.testing.assert_array_equal(seen[5], seen[10])
    assert np.all(seen[5] != final[4])
    np.testing.assert_array_equal(after.observations[0], final[-1])
    correct = (seen > 0.5) == (steps.action == 1)
    np.testing.assert_array_equal(steps.reward, 0.5 * correct)


def test_log_probabilities_are_those_of_the_acting_policy(collected):
    before, _, steps, _ = collected
    rows = inference.normalise(before.normaliser, steps.observation[:, 0].reshape(-1, 1))
    scores = np.asarray(inference.forward(before.parameters.actor, rows), dtype=np.float64)
    probabilities = np.exp(scores) / np.exp(scores).sum(axis=1, keepdims=True)
    taken = np.log(probabilities[np.arange(36), steps.action.reshape(-1)])
    np.testing.assert_allclose(steps.log_probability.reshape(-1), taken, atol=1e-5)


def test_returns_cover_whole_scenarios(collected):
    """They are unscaled, and include what was earned before the collection started.

    Two scenarios end in each environment.
    """
    _, after, steps, episodes = collected
    correct = (steps.observation[:, 0] > 0.5) == (steps.action == 1)
    assert episodes.ended.tolist() == [2.0, 2.0, 2.0]
    np.testing.assert_array_equal(
        episodes.episode_return, np.array([10.0, 20.0, 30.0]) + correct[:10].sum(axis=0)
    )
    np.testing.assert_array_equal(after.returns, correct[10:].sum(axis=0))
    assert episodes.metrics["success"].tolist() == [2.0, 2.0, 2.0]
