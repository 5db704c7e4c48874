"""Actions of a network, against numpy and against their probabilities."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning.choices import most_probable, sampled
from skystack.learning.inference import Normaliser

LOGITS = np.array([0.0, 1.5, -1.0], dtype=np.float32)
WEIGHTS = (
    ((jnp.zeros((2, 3)), jnp.asarray(LOGITS)),),
    Normaliser(jnp.zeros(2), jnp.ones(2), jnp.float32(1.0)),
)
"""A network whose logits are the same for every observation."""
OBSERVATION = jnp.array([0.3, 0.7])


def test_the_most_probable_action_has_the_largest_logit():
    assert int(most_probable(WEIGHTS, OBSERVATION, jax.random.key(0))) == int(LOGITS.argmax())


def test_actions_are_sampled_by_their_probabilities():
    keys = jax.random.split(jax.random.key(1), 4000)
    actions = jax.vmap(lambda key: sampled(WEIGHTS, OBSERVATION, key))(keys)
    shares = np.bincount(np.asarray(actions), minlength=3) / len(keys)
    expected = np.exp(LOGITS) / np.exp(LOGITS).sum()
    assert shares == pytest.approx(expected, abs=0.03)
