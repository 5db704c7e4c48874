"""Subroutines of compiled programs: a result that is used several times is computed once."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

Result = TypeVar("Result")


def subroutine(function: Callable[..., Result], *arguments: Any) -> Result:
    """The function's result, computed in a separate subroutine when it is compiled.

    XLA for CPUs generates one loop per output array and repeats in it all the cheap arithmetic that
    the array depends on: an intermediate result of ten arrays would be computed ten times. The
    results of a subroutine that is not inlined are computed once. The subroutine has the function's
    name, also in profiles.
    """
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
        return function(*arguments)

    @wraps(function)
    def body(*arguments: Any) -> Result:
        # Calls inside the subroutine may be inlined.
        with set_xla_metadata(inlineable=None):  # type: ignore[no-untyped-call]
            return function(*arguments)

    with set_xla_metadata(inlineable="false"):  # type: ignore[no-untyped-call]
        result: Result = jax.jit(body)(*arguments)
    return result
