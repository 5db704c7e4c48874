"""Compute only some columns of a result, chunk by chunk, if how many is known only at run time."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

Tree = TypeVar("Tree")


def wanted_first(
    order: Int[Array, " columns"], wanted: Bool[Array, " columns"]
) -> Int[Array, " columns"]:
    """The same order, with the wanted columns before the others."""
    is_wanted = wanted[order]
    before = jnp.cumsum(is_wanted.astype(jnp.int32))
    others = jnp.cumsum((~is_wanted).astype(jnp.int32))
    place = jnp.where(is_wanted, before - 1, before[-1] + others - 1)
    return jnp.zeros_like(order).at[place].set(order)


def in_chunks(
    wanted: Bool[Array, " columns"],
    function: Callable[[Int[Array, " chosen"]], Tree],
    before: Tree,
    size: int,
) -> Tree:
    """`before`, with the wanted columns replaced by those that the function computes.

    The function gets the numbers of up to `size` columns. Columns are on the last axis of all
    arrays. The work is proportional to the number of wanted columns, in whole chunks.
    """
    columns = wanted.shape[0]
    size = min(size, columns)
    # The last chunk is filled up with columns that stay as they are.
    order = wanted_first(jnp.arange(columns, dtype=jnp.int32), wanted)
    count = jnp.sum(wanted.astype(jnp.int32))

    def body(chunk: Int[Array, ""], result: Tree) -> Tree:
        column = jax.lax.dynamic_slice_in_dim(order, chunk * size, size)

        def put(values: Array, new: Array) -> Array:
            return values.at[..., column].set(jnp.where(wanted[column], new, values[..., column]))

        changed: Tree = jax.tree.map(put, result, function(column))
        return changed

    result: Tree = jax.lax.fori_loop(0, (count + size - 1) // size, body, before)
    return result
