"""Loops in compiled programs: unrolled, or as one body that is compiled once."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from skystack.compilation.subroutine import is_traced

Carried = TypeVar("Carried")


def repeated(
    step: Callable[[Carried, Any], tuple[Carried, Any]],
    value: Carried,
    count: int,
    unrolled: bool = False,
) -> tuple[Carried, Any]:
    """The value after `step(value, number)` for the numbers from 0 to `count - 1`, and the results.

    A step returns the next value and a result. The results are stacked on a new first axis.
    Compiled steps are a loop unless `unrolled`. A loop compiles faster, and keeps XLA from
    computing intermediate results of a long step several times. `count` is at least 1.
    """
    if not unrolled and is_traced(value):
        return jax.lax.scan(step, value, jnp.arange(count, dtype=jnp.int32))
    results = []
    for number in range(count):
        value, result = step(value, number)
        results.append(result)
    return value, jax.tree.map(lambda *each: jnp.stack(each), *results)
