"""Functions of the samples of active agents, when most columns may belong to absent ones."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

CHUNK = 1024
"""Columns are computed in chunks of this size."""


def active_first(
    order: Int[Array, " samples"], active: Bool[Array, " samples"]
) -> Int[Array, " samples"]:
    """The same order, with the active samples before the others."""
    is_active = active[order]
    before = jnp.cumsum(is_active.astype(jnp.int32))
    others = jnp.cumsum((~is_active).astype(jnp.int32))
    place = jnp.where(is_active, before - 1, before[-1] + others - 1)
    return jnp.zeros_like(order).at[place].set(order)


def of_active(
    function: Callable[[Float[Array, "rows n"]], Float[Array, "outputs n"]],
    outputs: int,
    columns: Float[Array, "rows columns"],
    active: Bool[Array, " columns"] | None,
) -> Float[Array, "outputs columns"]:
    """The function of each active column; zero for the others. None means that all are active.

    The work is proportional to the number of active columns.
    """
    if active is None:
        return function(columns)
    size = min(CHUNK, active.shape[0])
    order = active_first(jnp.arange(active.shape[0], dtype=jnp.int32), active)
    count = jnp.sum(active.astype(jnp.int32))

    def body(
        chunk: Int[Array, ""], result: Float[Array, "outputs columns"]
    ) -> Float[Array, "outputs columns"]:
        column = jax.lax.dynamic_slice_in_dim(order, chunk * size, size)
        values = jnp.where(active[column][None], function(columns[:, column]), 0.0)
        return result.at[:, column].set(values)

    nothing = jnp.zeros((outputs, active.shape[0]))
    result: Float[Array, "outputs columns"] = jax.lax.fori_loop(
        0, (count + size - 1) // size, body, nothing
    )
    return result
