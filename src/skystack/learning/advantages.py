"""The transitions that PPO collects, and their advantages."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.learning.settings import PPOSettings


class Transitions(NamedTuple):
    """The transitions that an update collects."""

    observation: Float[Array, "steps observation columns"]
    final_observation: Float[Array, "steps observation columns"]
    """The observation after the step, before an ended scenario is replaced."""
    action: Int[Array, "steps columns"]
    log_probability: Float[Array, "steps columns"]
    reward: Float[Array, "steps columns"]
    """The scaled reward."""
    terminated: Bool[Array, "steps columns"]
    truncated: Bool[Array, "steps columns"]
    time_steps: Float[Array, "steps columns"] | None = None
    """The number of time steps that each step takes; None means one."""
    active: Bool[Array, "steps columns"] | None = None
    """Whether the agent took a decision; None means always."""
    waiting: Bool[Array, "steps columns"] | None = None
    """Whether the agent took no decision but will take one later; None means never."""


def compute_gae(
    transitions: Transitions,
    values: Float[Array, "steps columns"],
    next_values: Float[Array, "steps columns"],
    settings: PPOSettings,
) -> Float[Array, "steps columns"]:
    """Generalised advantage estimation (Schulman et al. 2016).

    The value after a termination is 0; after a truncation it is the value of the final observation.
    Advantages do not propagate from one scenario to the previous one.
    """
    time_steps = transitions.time_steps
    discount = settings.gamma if time_steps is None else settings.gamma**time_steps
    target = transitions.reward + discount * jnp.where(transitions.terminated, 0.0, next_values)
    ended = transitions.terminated | transitions.truncated
    decay = discount * settings.gae_lambda
    if transitions.active is not None:  # nothing is learnt from what absent agents see
        assert transitions.waiting is not None
        ended |= ~(transitions.active | transitions.waiting)
        decay = jnp.where(transitions.waiting, discount, decay)
    decay *= 1.0 - ended.astype(jnp.float32)

    def backward(
        next_advantage: Float[Array, " columns"], step: tuple[Array, Array]
    ) -> tuple[Float[Array, " columns"], Float[Array, " columns"]]:
        error, step_decay = step
        advantage = error + step_decay * next_advantage
        return advantage, advantage

    start = jnp.zeros(values.shape[1])
    _, advantages = jax.lax.scan(backward, start, (target - values, decay), reverse=True)
    return advantages
