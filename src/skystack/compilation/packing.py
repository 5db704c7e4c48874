"""Pytrees packed into single arrays, which cost little to pass to a program and to fetch from it.

A program with three dozen small arguments or results takes longer to call than to run.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True, eq=False)  # interned, so that JAX compares layouts by identity
class Layout:
    """Where the arrays of a pytree are in the rows of the array that they are packed into."""

    tree: Any
    """The structure of the pytree, from `jax.tree.flatten`."""
    parts: tuple[tuple[slice, tuple[int, ...], np.dtype[Any]], ...]
    """For each array its rows, its shape without the batch axes, and its type."""


@partial(jax.tree_util.register_dataclass, data_fields=["rows"], meta_fields=["layout"])
@dataclass(frozen=True)
class Packed:
    """A pytree as one array `[rows, *batch]` of float32.

    Booleans and whole numbers up to 2**24 keep their values. As a result of a program, it also
    tells the caller what the pytree is.
    """

    rows: Any
    layout: Layout

    def unpacked(self) -> Any:
        """The pytree. Its arrays are of JAX or numpy, as `rows` is."""
        rows, batch = self.rows, self.rows.shape[1:]
        leaves = [rows[at].reshape(shape + batch) for at, shape, _ in self.layout.parts]
        typed = [
            leaf if leaf.dtype == dtype else leaf.astype(dtype)
            for leaf, (_, _, dtype) in zip(leaves, self.layout.parts, strict=True)
        ]
        return jax.tree.unflatten(self.layout.tree, typed)

    def fetched(self) -> Any:
        """The pytree in numpy, as arrays that must not be changed."""
        return Packed(np.asarray(self.rows), self.layout).unpacked()


def packed(values: Any, batch_axes: int = 0) -> Packed:
    """A pytree of arrays, packed. Batch axes are last in every array."""
    leaves, tree = jax.tree.flatten(values)
    leaves = [jnp.asarray(leaf) for leaf in leaves]
    own = [leaf.ndim - batch_axes for leaf in leaves]
    kinds = tuple((leaf.shape[:axes], leaf.dtype) for leaf, axes in zip(leaves, own, strict=True))
    rows = [
        leaf.reshape(-1, *leaf.shape[axes:]).astype(jnp.float32)
        for leaf, axes in zip(leaves, own, strict=True)
    ]
    return Packed(jnp.concatenate(rows), _layout(tree, kinds))


@cache
def _layout(tree: Any, kinds: tuple[tuple[tuple[int, ...], np.dtype[Any]], ...]) -> Layout:
    ends = np.cumsum([np.prod(shape, dtype=int) for shape, _ in kinds]).tolist()
    rows = [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
    parts = [(at, shape, dtype) for at, (shape, dtype) in zip(rows, kinds, strict=True)]
    return Layout(tree, tuple(parts))
