"""Subroutines are computed once in a program, and traced once in a process."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from skystack.compilation.subroutine import subroutine


def test_it_computes_its_function():
    def both(x):
        return jnp.sin(x), x + 1.0

    for f in (lambda x: subroutine(both, x), jax.jit(lambda x: subroutine(both, x))):
        for found, expected in zip(f(jnp.arange(3.0)), both(jnp.arange(3.0)), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_it_is_called_once_for_all_its_consumers():
    """Otherwise the long sum would be computed again in the loop of every consumer."""

    def long_sum(x):
        for number in range(20):
            x = x * 1.5 + number
        return x

    def consumers(x):
        y = subroutine(long_sum, x)
        return y + 1.0, y * y, jnp.max(y), y[::2]

    compiled = jax.jit(consumers).lower(jnp.arange(8.0)).compile().as_text()
    assert compiled.count(" call(") == 1
    assert "long_sum" in compiled


TRACED = []
"""The factors for which a function has been traced."""


def times(factor, x):
    TRACED.append(factor)
    return factor * x


@dataclass(frozen=True)
class Scale:
    factor: float

    def apply(self, x):
        return times(self.factor, x)


def traced_for(*programs):
    """The results of programs for the same argument, and the factors that are traced for them."""
    TRACED.clear()
    return [jax.jit(program)(jnp.ones(5)).tolist()[0] for program in programs], list(TRACED)


def test_equal_constants_share_a_trace_and_others_do_not():
    programs = (
        lambda x: subroutine(partial(times, 11.0), x),
        lambda x: subroutine(partial(times, 11.0), x) + 1.0,
        lambda x: subroutine(partial(times, 12.0), x),
    )
    assert traced_for(*programs) == ([11.0, 12.0, 12.0], [11.0, 12.0])


def test_methods_of_equal_objects_share_a_trace():
    programs = (
        lambda x: subroutine(Scale(13.0).apply, x),
        lambda x: subroutine(Scale(13.0).apply, x) + 1.0,
        lambda x: subroutine(Scale(14.0).apply, x),
    )
    assert traced_for(*programs) == ([13.0, 14.0, 14.0], [13.0, 14.0])


def test_functions_with_variables_of_their_own_share_nothing():
    def local(factor):
        return lambda x: subroutine(lambda x: times(factor, x), x)

    assert traced_for(local(15.0), local(16.0)) == ([15.0, 16.0], [15.0, 16.0])


def test_constants_of_other_types_share_nothing():
    results, traced = traced_for(
        lambda x: subroutine(partial(times, 1), x), lambda x: subroutine(partial(times, 1.0), x)
    )
    assert results == [1.0, 1.0]
    assert [type(each) for each in traced] == [int, float]
