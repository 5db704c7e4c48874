"""Results of programs, as numpy arrays."""

from typing import TypeVar

import jax
import numpy as np

Tree = TypeVar("Tree")


def fetched(values: Tree) -> Tree:
    """A pytree with a numpy array, which is read-only, for each array of JAX.

    For results of many small arrays that are fetched often: `jax.device_get` first starts a copy
    of each array, which takes several times as long. The arrays may share memory with those of JAX.
    """
    arrays: Tree = jax.tree.map(np.asarray, values)
    return arrays
