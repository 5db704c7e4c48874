"""Compiled programs that equal objects share, so that each is traced and compiled once."""

from collections.abc import Callable
from functools import lru_cache, partial, wraps
from types import MethodType
from typing import Any

import jax

_MOST_PROGRAMS = 64


def shared_program(function: Callable[..., Any], *constants: Any) -> Callable[..., Any]:
    """The compiled program `(*arguments) -> function(*constants, *arguments)`.

    It is the same one for equal constants; the object of a method is one of them. Constants without
    a hash have a program of their own.
    """
    if isinstance(function, MethodType):
        return shared_program(function.__func__, function.__self__, *constants)
    try:
        return _shared_program(function, *constants)
    except TypeError:
        return _program(function, *constants)


def with_constants(function: Callable[..., Any], *constants: Any) -> Callable[..., Any]:
    """A partial function with the name of the function, also in profiles."""
    return wraps(function)(partial(function, *constants))


def _program(function: Callable[..., Any], *constants: Any) -> Callable[..., Any]:
    return jax.jit(with_constants(function, *constants))


_shared_program = lru_cache(_MOST_PROGRAMS, typed=True)(_program)
