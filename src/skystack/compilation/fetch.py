"""Results of programs, as numpy arrays."""

from typing import TypeVar

import jax
import numpy as np

Tree = TypeVar("Tree")


def fetched(values: Tree) -> Tree:
    """The pytree with each JAX array replaced by a read-only numpy array.

    For results of many small arrays that are fetched often: `jax.device_get` first starts a copy
    of each array, which takes several times as long. The arrays may share memory with those of JAX.
    """
    arrays: Tree = jax.tree.map(np.asarray, values)
    return arrays
