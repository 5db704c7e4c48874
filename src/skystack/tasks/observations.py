"""Flattening of structured observations to the vectors that networks and policies use."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from skystack.tasks.contract import Observation


def flatten_observation(observation: Observation, batch_axes: int = 0) -> Float[Array, "..."]:
    """The observation as one array `[observation, *batch]`, leaf by leaf in JAX's order.

    `batch_axes` is the number of batch axes, which are last in every leaf.
    """
    leaves = [_flat(leaf, batch_axes) for leaf in jax.tree.leaves(observation)]
    return leaves[0] if len(leaves) == 1 else jnp.concatenate(leaves)


def _flat(leaf: Array, batch_axes: int) -> Array:
    if leaf.ndim == batch_axes + 1:
        return leaf
    return leaf.reshape(-1, *leaf.shape[leaf.ndim - batch_axes :])
