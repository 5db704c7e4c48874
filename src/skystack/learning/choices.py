"""The actions that a policy's network chooses, inside compiled programs."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from skystack.learning.inference import Layers, Normaliser, forward, normalise
from skystack.tasks.observations import flatten_observation

Weights = tuple[Layers, Normaliser]
"""(actor, normaliser)."""


def most_probable(weights: Weights, observation: Array, key: PRNGKeyArray) -> Int[Array, ""]:
    """The most probable action; the key is not used."""
    return jnp.argmax(_logits(weights, observation)).astype(jnp.int32)


def sampled(weights: Weights, observation: Array, key: PRNGKeyArray) -> Int[Array, ""]:
    """An action drawn by its probability."""
    return jax.random.categorical(key, _logits(weights, observation)).astype(jnp.int32)


def _logits(weights: Weights, observation: Array) -> Array:
    actor, normaliser = weights
    logits: Array = forward(actor, normalise(normaliser, flatten_observation(observation)))
    return logits
