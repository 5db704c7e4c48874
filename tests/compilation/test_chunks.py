"""Computing only some columns of a result."""

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.compilation.chunks import in_chunks, wanted_first

CHUNK = 16


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_wanted_columns_come_first_in_the_same_order(share):
    rng = np.random.default_rng(1)
    wanted = jnp.asarray(rng.random(50) < share)
    order = rng.permutation(50)
    found = np.asarray(wanted_first(jnp.asarray(order, dtype=jnp.int32), wanted))
    flags = np.asarray(wanted)[order]
    np.testing.assert_array_equal(found, np.concatenate([order[flags], order[~flags]]))


@pytest.mark.parametrize("count", [0, 1, CHUNK, CHUNK + 1, 3 * CHUNK - 5])
@pytest.mark.parametrize("columns", [3 * CHUNK - 5, CHUNK - 3])
def test_only_wanted_columns_are_computed(count, columns):
    rng = np.random.default_rng(count)
    wanted = np.zeros(columns, dtype=bool)
    wanted[rng.permutation(columns)[:count]] = True
    values = jnp.where(jnp.asarray(wanted), jnp.arange(columns, dtype=jnp.float32), jnp.nan)
    before = {"one": jnp.full(columns, -1.0), "two": jnp.full((2, columns), -2.0)}

    def function(column):
        chosen = values[column]
        return {"one": 2.0 * chosen, "two": jnp.stack([chosen, chosen + 1.0])}

    found = in_chunks(jnp.asarray(wanted), function, before, CHUNK)
    number = np.arange(columns)
    np.testing.assert_array_equal(found["one"], np.where(wanted, 2.0 * number, -1.0))
    np.testing.assert_array_equal(found["two"], np.where(wanted, [number, number + 1.0], -2.0))
