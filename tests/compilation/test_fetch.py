"""Results of programs become numpy arrays."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from skystack.compilation.fetch import fetched


class Values(NamedTuple):
    flags: object
    nothing: None
    already: np.ndarray


def test_all_arrays_become_numpy_arrays():
    values = Values(jnp.array([True, False]), None, np.arange(3))
    result = fetched({"values": values, "scalar": jnp.float32(0.5)})
    assert isinstance(result["values"], Values)
    assert result["values"].nothing is None
    for found, expected in (
        (result["values"].flags, np.array([True, False])),
        (result["values"].already, np.arange(3)),
        (result["scalar"], np.array(0.5, dtype=np.float32)),
    ):
        assert type(found) is np.ndarray
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
