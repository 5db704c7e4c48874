"""Compiled programs that equal objects share, so that each is traced and compiled once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache, partial
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import jax
import msgspec

import skystack.compilation.random_bits  # noqa: F401  (how all programs draw random numbers)

Function = Callable[..., Any]

_MOST_PROGRAMS = 64
_SIMPLE = (str, bytes, bool, int, float, type(None), type, FunctionType, BuiltinFunctionType)


def shared_program(function: Function, *constants: Any) -> Function:
    """The compiled program `(*arguments) -> function(*constants, *arguments)`.

    Equal constants share one program; the object of a method counts as a constant. If a constant is
    not a value (`is_value`), the program is not shared.
    """
    function, constants = unbound(function, *constants)
    return PROGRAMS.get(function, constants)


def unbound(function: Function, *constants: Any) -> tuple[Function, tuple[Any, ...]]:
    """A function, and what is bound to it: the object of a method comes first."""
    if isinstance(function, MethodType):
        return function.__func__, (function.__self__, *constants)
    return function, constants


def with_constants(function: Function, *constants: Any) -> Function:
    """A partial function with the name of the function, also in profiles."""
    bound: Any = partial(function, *constants)
    # Not `wraps`, with which JAX would take the constants for arguments.
    bound.__name__ = getattr(function, "__name__", "program")
    bound.__qualname__ = getattr(function, "__qualname__", "program")
    result: Function = bound
    return result


@dataclass(frozen=True)
class _Wanted:
    """A program, identified by its function and by what it depends on."""

    function: Function
    key: tuple[Any, ...]
    kinds: tuple[type, ...]
    """The types of the key's parts: 1 and 1.0 are equal, but not to JAX."""
    constants: tuple[Any, ...] = field(compare=False)


class Shared:
    """Keeps the programs that were used last, by their functions and what they depend on."""

    def __init__(self, make: Callable[..., Function], most: int) -> None:
        """`make(function, *constants)` makes a program."""
        self._make = make
        self._kept = lru_cache(most)(lambda wanted: make(wanted.function, *wanted.constants))

    def get(
        self,
        function: Function,
        constants: tuple[Any, ...],
        key: tuple[Any, ...] | None = None,
    ) -> Function:
        """The program of a function with constants. Equal keys share it if they are values.

        The key is what the program depends on; by default, the constants.
        """
        key = constants if key is None else key
        wanted = _Wanted(function, key, tuple(map(type, key)), constants)
        if all(map(is_value, key)) and _has_hash(wanted):
            return self._kept(wanted)
        return self._make(function, *constants)


def is_value(thing: Any) -> bool:
    """Whether something is an immutable value: whatever equals it behaves like it.

    Numbers, strings, functions and classes are values. So are tuples, and frozen dataclasses and
    structs that are compared by all their fields, if all their parts are values. A subclass of a
    dataclass that is not a dataclass itself is not a value, because its own attributes are not
    compared. Mappings and lists inside a value are assumed not to change.
    """
    if isinstance(thing, _SIMPLE):
        return True
    if isinstance(thing, (tuple, list)):
        return all(map(is_value, thing))
    if isinstance(thing, Mapping):
        return all(is_value(part) for pair in thing.items() for part in pair)
    return _is_frozen(thing) and all(map(is_value, _parts(thing)))


def _has_hash(thing: Any) -> bool:
    try:
        hash(thing)
    except TypeError:
        return False
    return True


def _is_frozen(thing: Any) -> bool:
    kind: Any = type(thing)
    if isinstance(thing, msgspec.Struct):
        return bool(kind.__struct_config__.frozen)
    if not is_dataclass(thing) or "__dataclass_fields__" not in vars(kind):
        return False
    return kind.__dataclass_params__.frozen and all(each.compare for each in fields(thing))


def _parts(thing: Any) -> list[Any]:
    if isinstance(thing, msgspec.Struct):
        return [getattr(thing, name) for name in thing.__struct_fields__]
    return [getattr(thing, each.name) for each in fields(thing)]


def _compiled(function: Function, *constants: Any) -> Function:
    return jax.jit(with_constants(function, *constants))


PROGRAMS = Shared(_compiled, _MOST_PROGRAMS)
"""The programs of this process."""
