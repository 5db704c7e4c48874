"""Subroutines of compiled programs: what they compute is computed once, however many read it."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

Result = TypeVar("Result")


def subroutine(function: Callable[..., Result], *arguments: Any) -> Result:
    """The function's result; in a compiled program as a subroutine of its own.

    XLA for CPUs makes one loop for each array that is kept, and repeats in it all cheap arithmetic
    that leads there: what ten arrays are made from would be computed ten times. A subroutine that
    is not inlined ends that at its results. It has the function's name, in profiles too.
    """
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
        return function(*arguments)

    @wraps(function)
    def body(*arguments: Any) -> Result:
        # What is inside may be inlined there.
        with set_xla_metadata(inlineable=None):  # type: ignore[no-untyped-call]
            return function(*arguments)

    with set_xla_metadata(inlineable="false"):  # type: ignore[no-untyped-call]
        result: Result = jax.jit(body)(*arguments)
    return result
