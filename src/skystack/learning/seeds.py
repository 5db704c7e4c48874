"""Random keys: scenarios for judging are the same for everybody and never seen in training."""

import jax
import numpy as np
from jaxtyping import Array, Int, Key, PRNGKeyArray

TRAINING, EVALUATION = 0x7EA1_0001, 0x5CE7_A210
"""Folded into every key first, so that training and evaluation never draw under the same key."""


def training_key(seed: int) -> PRNGKeyArray:
    """The key from which everything random of a training run derives."""
    return jax.random.fold_in(jax.random.key(seed), TRAINING)


def scenario_key(seed: int | Int[Array, ""], scenario: int | Int[Array, ""]) -> PRNGKeyArray:
    """The key of one scenario: depends on the evaluation seed and its number only."""
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), EVALUATION), scenario)


def scenario_keys(seed: int, scenarios: Int[np.ndarray, " n"]) -> Key[Array, " n"]:
    """The keys of many scenarios."""
    keys: Key[Array, " n"] = _many_keys(seed, scenarios)
    return keys


_many_keys = jax.jit(jax.vmap(scenario_key, (None, 0)))
