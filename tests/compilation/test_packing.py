"""Pytrees packed into single arrays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.compilation.packing import packed


def tree(batch=()):
    """A pytree of mixed shapes and types, with batch axes last."""
    rng = np.random.default_rng(1)
    return {
        "matrix": jnp.asarray(rng.random((2, 3, *batch)), dtype=jnp.float32),
        "flags": (jnp.asarray(rng.random((4, *batch)) < 0.5), None),
        "count": jnp.asarray(rng.integers(0, 2**24, batch), dtype=jnp.int32),
        "none": jnp.zeros((0, *batch)),
    }


def assert_same(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("batch", [(), (5,), (5, 2)])
def test_what_is_packed_can_be_unpacked_in_numpy_and_in_a_program(batch):
    expected = tree(batch)
    made = jax.jit(lambda values: packed(values, len(batch)))(expected)
    assert made.rows.shape == (11, *batch)
    assert_same(made.fetched(), expected)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(made.fetched()))
    assert_same(jax.jit(lambda each: each.unpacked())(made), expected)


def test_programs_take_what_other_programs_packed_without_compiling_again():
    program = jax.jit(lambda each: packed(each.unpacked()))
    first = jax.jit(packed)(tree())
    second = jax.jit(lambda values: packed(jax.tree.map(lambda leaf: leaf, values)))(tree())
    for each in (first, second, program(first)):
        program(each)
    assert program._cache_size() == 1
