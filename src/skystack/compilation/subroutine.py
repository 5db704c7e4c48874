"""Subroutines of compiled programs: a result that is used several times is computed once."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

from skystack.compilation.shared import Shared, unbound, with_constants

Result = TypeVar("Result")

_MOST_TRACED = 512


def subroutine(function: Callable[..., Result], *arguments: Any) -> Result:
    """The function's result, computed in a separate subroutine when it is compiled.

    XLA for CPUs generates one loop per output array and repeats in it all the cheap arithmetic that
    the array depends on: an intermediate result of ten arrays would be computed ten times. The
    results of a subroutine that is not inlined are computed once. The subroutine has the function's
    name, also in profiles.

    A partial function or a method is traced once per process for arguments of the same shapes,
    whichever program calls it, if what is bound to it is a value
    (`skystack.compilation.shared.is_value`).
    """
    if not is_traced(arguments):
        return function(*arguments)
    with set_xla_metadata(inlineable="false"):  # type: ignore[no-untyped-call]
        result: Result = _program_of(function)(*arguments)
    return result


def is_traced(values: Any) -> bool:
    """Whether a tree has traced values: the calling program is being compiled."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))


def _program_of(function: Callable[..., Any]) -> Callable[..., Any]:
    if isinstance(function, partial) and not function.keywords:
        function, bound = unbound(function.func, *function.args)
    else:
        function, bound = unbound(function)
    # A function to which nothing is bound may close over traced values of its caller.
    return _TRACED.get(function, bound) if bound else _program(function)


def _program(function: Callable[..., Any], *bound: Any) -> Callable[..., Any]:
    named = with_constants(function, *bound)

    @wraps(named)
    def body(*arguments: Any) -> Any:
        # Calls inside the subroutine may be inlined.
        with set_xla_metadata(inlineable=None):  # type: ignore[no-untyped-call]
            return named(*arguments)

    return jax.jit(body)


_TRACED = Shared(_program, _MOST_TRACED)
