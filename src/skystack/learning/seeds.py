"""Random keys. Evaluation scenarios depend only on seed and number, and never occur in training."""

import jax
import numpy as np
from jaxtyping import Array, Int, Key, PRNGKeyArray

TRAINING, EVALUATION = 0x7EA1_0001, 0x5CE7_A210
"""Folded into every key first, so that training and evaluation never use the same key."""


def training_key(seed: int) -> PRNGKeyArray:
    """The key from which all randomness of a training run derives."""
    return jax.random.fold_in(jax.random.key(seed), TRAINING)


def scenario_key(seed: int | Int[Array, ""], scenario: int | Int[Array, ""]) -> PRNGKeyArray:
    """The key of one scenario. It depends only on the evaluation seed and the scenario's number."""
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), EVALUATION), scenario)


def scenario_keys(seed: int, scenarios: Int[np.ndarray, " n"]) -> Key[Array, " n"]:
    """The keys of many scenarios."""
    keys: Key[Array, " n"] = _many_keys(seed, scenarios)
    return keys


_many_keys = jax.jit(jax.vmap(scenario_key, (None, 0)))
