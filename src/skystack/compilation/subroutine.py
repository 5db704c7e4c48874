"""Subroutines of compiled programs: a result that is used several times is computed once."""

from collections.abc import Callable
from functools import lru_cache, partial, wraps
from types import MethodType
from typing import Any, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

from skystack.compilation.shared import with_constants

Result = TypeVar("Result")

_MOST_PROGRAMS = 512


def subroutine(function: Callable[..., Result], *arguments: Any) -> Result:
    """The function's result, computed in a separate subroutine when it is compiled.

    XLA for CPUs generates one loop per output array and repeats in it all the cheap arithmetic that
    the array depends on: an intermediate result of ten arrays would be computed ten times. The
    results of a subroutine that is not inlined are computed once. The subroutine has the function's
    name, also in profiles.

    A partial function or a method is traced only once in a process for arguments of the same
    shapes, in whatever programs. What is bound to it must be constant.
    """
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
        return function(*arguments)
    with set_xla_metadata(inlineable="false"):  # type: ignore[no-untyped-call]
        result: Result = _program_of(function)(*arguments)
    return result


def _program_of(function: Callable[..., Any]) -> Callable[..., Any]:
    if isinstance(function, MethodType):
        return _shared_program(function.__func__, function.__self__)
    if isinstance(function, partial) and not function.keywords:
        return _shared_program(function.func, *function.args)
    # Any other function may have variables of the program that calls it.
    return _program(function)


@lru_cache(_MOST_PROGRAMS, typed=True)
def _shared_program(function: Callable[..., Any], *bound: Any) -> Callable[..., Any]:
    return _program(with_constants(function, *bound))


def _program(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def body(*arguments: Any) -> Any:
        # Calls inside the subroutine may be inlined.
        with set_xla_metadata(inlineable=None):  # type: ignore[no-untyped-call]
            return function(*arguments)

    return jax.jit(body)
