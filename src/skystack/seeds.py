"""Random keys: scenarios for judging are the same for everybody and never seen in training."""

import jax
from jaxtyping import PRNGKeyArray

TRAINING, EVALUATION = 0x7EA1_0001, 0x5CE7_A210
"""Folded into every key first, so that training and evaluation never draw under the same key."""


def training_key(seed: int) -> PRNGKeyArray:
    """The key from which everything random of a training run derives."""
    return jax.random.fold_in(jax.random.key(seed), TRAINING)


def scenario_key(seed: int, scenario: int) -> PRNGKeyArray:
    """The key of one scenario: depends on the evaluation seed and its number only."""
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), EVALUATION), scenario)
