"""Loops give the same results unrolled, compiled as one body, and outside compiled programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.compilation.loops import repeated


def powers(value, unrolled=False):
    """Doubles three times; the results are the values before, and the numbers of the steps."""
    return repeated(lambda each, number: (2.0 * each, (each, number)), value, 3, unrolled)


@pytest.mark.parametrize("unrolled", [False, True])
@pytest.mark.parametrize("compiled", [False, True])
def test_steps_follow_each_other_and_results_are_stacked(unrolled, compiled):
    function = jax.jit(powers, static_argnums=1) if compiled else powers
    value, (before, numbers) = function(jnp.array([1.0, 10.0]), unrolled)
    np.testing.assert_array_equal(value, [8.0, 80.0])
    np.testing.assert_array_equal(before, [[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    np.testing.assert_array_equal(numbers, [0, 1, 2])


@pytest.mark.parametrize(("unrolled", "bodies"), [(False, 1), (True, 3)])
def test_a_compiled_loop_has_one_body(unrolled, bodies):
    program = jax.make_jaxpr(lambda value: powers(value, unrolled))(jnp.ones(2))
    assert str(program).count("mul") == bodies
