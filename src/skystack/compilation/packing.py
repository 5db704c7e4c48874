"""Pytrees packed into single arrays, which cost little to pass to a program and to fetch from it.

A program with three dozen small arguments or results takes longer to call than to run.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from skystack.errors import InputError


class _PackedArray(NamedTuple):
    """What an array of a pytree is, and how many rows it takes."""

    shape: tuple[int, ...]
    """Without the batch axes."""
    dtype: np.dtype[Any]
    rows: int
    generator: str | None
    """That of random keys; None for numbers."""


@dataclass(frozen=True, eq=False)  # layouts are interned, so comparing identities is enough
class Layout:
    """Where the arrays of a pytree are in the rows of the array that they are packed into."""

    tree: Any
    """The structure of the pytree, from `jax.tree.flatten`."""
    parts: tuple[tuple[slice, _PackedArray], ...]
    """The rows of each array, and what it is."""

    def __copy__(self) -> "Layout":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "Layout":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        # JAX cannot pickle tree structures that contain user-defined classes.
        kinds = tuple(kind for _, kind in self.parts)
        like: Any = jax.ShapeDtypeStruct
        leaves = [like(kind.shape, kind.dtype) for kind in kinds]
        return _layout_like, (jax.tree.unflatten(self.tree, leaves), kinds)


@partial(jax.tree_util.register_dataclass, data_fields=["rows"], meta_fields=["layout"])
@dataclass(frozen=True)
class Packed:
    """A pytree as one array `[rows, *batch]` of int32, which holds the bits of the pytree's arrays.

    As a result of a program, it also tells the caller what the pytree is. Numbers of at most 32
    bits, booleans and random keys keep their values.
    """

    rows: Any
    layout: Layout

    def unpacked(self) -> Any:
        """The pytree. Its arrays are JAX or numpy arrays, like `rows`."""
        leaves = [_restored(self.rows[at], kind) for at, kind in self.layout.parts]
        return jax.tree.unflatten(self.layout.tree, leaves)

    def fetched(self) -> Any:
        """The pytree with numpy arrays of its own."""
        return Packed(np.array(self.rows), self.layout).unpacked()


def packed(values: Any, batch_axes: int = 0) -> Packed:
    """A pytree of arrays, packed. Batch axes are last in every array.

    Raises InputError for numbers of more than 32 bits.
    """
    leaves, tree = jax.tree.flatten(values)
    rows, kinds = [jnp.zeros((0,), dtype=jnp.int32)] if not leaves else [], []
    for leaf in map(jnp.asarray, leaves):
        own = leaf.ndim - batch_axes
        bits = _bits(leaf)
        count = int(np.prod(bits.shape[: bits.ndim - batch_axes], dtype=int))
        rows.append(bits.reshape(count, *leaf.shape[own:]))
        generator = str(jax.random.key_impl(leaf)) if _are_keys(leaf) else None
        kinds.append(_PackedArray(leaf.shape[:own], leaf.dtype, count, generator))
    return Packed(jnp.concatenate(rows), _layout(tree, tuple(kinds)))


def _are_keys(leaf: Array) -> bool:
    return bool(jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key))


def _bits(leaf: Array) -> Array:
    """The bits of an array as int32; those of random keys on an axis before the others."""
    if _are_keys(leaf):
        leaf = jnp.moveaxis(jax.random.key_data(leaf), -1, 0)
    if leaf.dtype.itemsize > 4:
        raise InputError(f"there are arrays of {leaf.dtype} (allowed: types of at most 32 bits)")
    if jnp.issubdtype(leaf.dtype, jnp.floating):
        return jax.lax.bitcast_convert_type(leaf.astype(jnp.float32), jnp.int32)
    if leaf.dtype == jnp.uint32:
        return jax.lax.bitcast_convert_type(leaf, jnp.int32)
    return leaf.astype(jnp.int32)


def _restored(bits: Any, kind: _PackedArray) -> Any:
    """The array that `_bits` came from."""
    batch, reinterpreted = bits.shape[1:], partial(_reinterpreted, bits)
    if kind.generator is not None:
        data = reinterpreted(np.uint32).reshape((-1, *kind.shape, *batch))
        return jax.random.wrap_key_data(jnp.moveaxis(data, 0, -1), impl=kind.generator)
    if kind.dtype == np.bool_:
        values = bits != 0
    elif jnp.issubdtype(kind.dtype, jnp.floating):
        values = reinterpreted(np.float32)
    else:
        values = reinterpreted(np.uint32) if kind.dtype == np.uint32 else bits
    values = values.reshape(kind.shape + batch)
    return values if values.dtype == kind.dtype else values.astype(kind.dtype)


def _reinterpreted(bits: Any, dtype: Any) -> Any:
    """The same bits as another type of 32 bits."""
    if isinstance(bits, np.ndarray):
        return bits.view(dtype)
    return jax.lax.bitcast_convert_type(bits, dtype)


def _layout_like(example: Any, kinds: tuple[_PackedArray, ...]) -> Layout:
    return _layout(jax.tree.structure(example), kinds)


def _layout(tree: Any, kinds: tuple[_PackedArray, ...]) -> Layout:
    ends = np.cumsum([kind.rows for kind in kinds]).tolist()
    rows = [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
    return _LAYOUTS.setdefault((tree, kinds), Layout(tree, tuple(zip(rows, kinds, strict=True))))


_LAYOUTS: dict[tuple[Any, tuple[_PackedArray, ...]], Layout] = {}
