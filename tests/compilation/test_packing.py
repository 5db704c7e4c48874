"""Pytrees packed into single arrays."""

import copy
import pickle
from dataclasses import dataclass
from functools import partial

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
        "count": jnp.asarray(rng.integers(-(2**31), 2**31, batch), dtype=jnp.int32),
        "bits": jnp.asarray(rng.integers(0, 2**32, batch), dtype=jnp.uint32),
        "small": jnp.asarray(rng.integers(-128, 128, batch), dtype=jnp.int8),
        "half": jnp.asarray(rng.random(batch), dtype=jnp.bfloat16),
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
    assert made.rows.shape == (14, *batch)
    assert_same(made.fetched(), expected)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(made.fetched()))
    assert_same(jax.jit(lambda each: each.unpacked())(made), expected)


@pytest.mark.parametrize("batch", [(), (3,)])
def test_random_keys_are_preserved(batch):
    """Tasks with random steps keep a key in their state."""
    keys = jax.random.split(jax.random.key(2), (2, *batch))
    made = jax.jit(lambda values: packed(values, len(batch)))(
        {"keys": keys, "time": keys[0] == keys[0]}
    )
    inside = jax.jit(lambda each: each.unpacked()["keys"])(made)
    for found in (made.fetched()["keys"], inside):
        assert found.dtype == keys.dtype
        np.testing.assert_array_equal(jax.random.key_data(found), jax.random.key_data(keys))


def test_programs_take_what_other_programs_packed_without_compiling_again():
    program = jax.jit(lambda each: packed(each.unpacked()))
    first = jax.jit(packed)(tree())
    second = jax.jit(lambda values: packed(jax.tree.map(lambda leaf: leaf, values)))(tree())
    for each in (first, second, program(first)):
        program(each)
    assert program._cache_size() == 1


@partial(jax.tree_util.register_dataclass, data_fields=["value"], meta_fields=["name"])
@dataclass
class Named:
    """A user-defined node of a pytree."""

    value: object
    name: str


def test_copies_have_the_same_layout_and_are_not_compiled_again():
    made = jax.jit(packed)({"one": Named(jnp.arange(3.0), "first"), "two": jnp.zeros((), bool)})
    program = jax.jit(lambda each: each.unpacked()["one"].value + 1.0)
    for each in (made, copy.deepcopy(made), pickle.loads(pickle.dumps(made))):
        assert each.layout is made.layout
        np.testing.assert_array_equal(program(each), [1.0, 2.0, 3.0])
    assert program._cache_size() == 1
