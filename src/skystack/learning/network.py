"""The initial actor and critic, and the updates of the observation normaliser.

The networks are two separate fully connected networks (section "Agent Training Configuration" of
the paper).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from skystack.learning.inference import Layers, Normaliser


class Head(NamedTuple):
    """How to compute the logits of the actions from the outputs of a policy network."""

    outputs: int
    """The number of outputs."""
    logits: Callable[[Float[Array, "outputs n"]], Float[Array, "actions n"]]
    """Maps the outputs to one logit per action."""


class Parameters(NamedTuple):
    """The parameters of both networks."""

    actor: Layers
    critic: Layers


def init(
    key: PRNGKeyArray, observation_size: int, hidden: tuple[int, ...], actions: int
) -> Parameters:
    """Orthogonal weights and zero biases, which give a nearly uniform initial policy."""
    actor_key, critic_key = jax.random.split(key)
    return Parameters(
        init_layers(actor_key, (observation_size, *hidden, actions), last_gain=0.01),
        init_layers(critic_key, (observation_size, *hidden, 1), last_gain=1.0),
    )


def init_layers(key: PRNGKeyArray, sizes: tuple[int, ...], last_gain: float) -> Layers:
    layers = []
    for index, layer_key in enumerate(jax.random.split(key, len(sizes) - 1)):
        gain = last_gain if index == len(sizes) - 2 else 2.0**0.5
        weights = jax.nn.initializers.orthogonal(gain)(
            layer_key, (sizes[index], sizes[index + 1]), jnp.float32
        )
        layers.append((weights, jnp.zeros(sizes[index + 1])))
    return tuple(layers)


def initial_normaliser(observation_size: int) -> Normaliser:
    """A normaliser for uniform observations on [0, 1], with negligible weight against data."""
    return Normaliser(
        jnp.full(observation_size, 0.5, dtype=jnp.float32),
        jnp.full(observation_size, 1.0 / 12.0, dtype=jnp.float32),
        jnp.asarray(1e-3, dtype=jnp.float32),
    )


def no_normaliser(observation_size: int) -> Normaliser:
    """A normaliser that leaves observations on [0, 1] as they are."""
    return Normaliser(
        jnp.zeros(observation_size, dtype=jnp.float32),
        jnp.ones(observation_size, dtype=jnp.float32),
        jnp.asarray(1.0, dtype=jnp.float32),
    )


def update_normaliser(
    normaliser: Normaliser,
    observations: Float[Array, "observation samples"],
    active: Bool[Array, " samples"] | None = None,
) -> Normaliser:
    """The normaliser updated with new observations (Chan et al. 1979), or with the active ones."""
    samples: float | Array = float(observations.shape[1])
    where = None
    if active is not None:
        samples, where = jnp.sum(active.astype(jnp.float32)), active[None]
    count = normaliser.count + samples
    delta = jnp.mean(observations, axis=1, where=where) - normaliser.mean
    spread = (
        normaliser.variance * normaliser.count
        + jnp.var(observations, axis=1, where=where) * samples
        + delta**2 * normaliser.count * samples / count
    )
    return Normaliser(normaliser.mean + delta * samples / count, spread / count, count)
