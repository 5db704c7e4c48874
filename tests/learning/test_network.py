"""First weights, and what a network is asked with."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning import inference, network


def test_first_weights_are_orthogonal_and_biases_zero():
    """Gain sqrt(2) before a ReLU; 0.01 and 1 for the last layers of actor and critic."""
    parameters = network.init(jax.random.key(1), 8, (16, 12), 5)
    for layers, outputs, last_gain in ((parameters.actor, 5, 0.01), (parameters.critic, 1, 1.0)):
        shapes = [weights.shape for weights, _ in layers]
        assert shapes == [(8, 16), (16, 12), (12, outputs)]
        for (weights, biases), gain in zip(layers, [2**0.5, 2**0.5, last_gain], strict=True):
            smaller = (
                weights @ weights.T
                if weights.shape[0] < weights.shape[1]
                else (weights.T @ weights)
            )
            np.testing.assert_allclose(smaller, gain**2 * np.eye(len(smaller)), atol=1e-5)
            assert biases.tolist() == [0.0] * weights.shape[1]
    assert not np.allclose(parameters.actor[0][0], parameters.critic[0][0])


def test_a_network_is_what_its_weights_say():
    """By hand: one hidden layer, whose second unit is cut at zero."""
    layers = (
        (np.array([[1.0, -1.0], [2.0, 0.5]]), np.array([0.5, -3.0])),
        (np.array([[2.0], [10.0]]), np.array([-1.0])),
    )
    seen = np.array([[1.0, 1.0], [-2.0, 4.0]])
    # Units: 3.5 and -3.5 -> 0; 6.5 and 1.
    expected = [[6.0], [22.0]]
    np.testing.assert_allclose(inference.forward(layers, seen), expected)
    assert inference.forward(layers, seen[0]).tolist() == expected[0]
    in_jax = jax.tree.map(lambda value: jnp.asarray(value, dtype=jnp.float32), layers)
    columns = inference.forward(in_jax, jnp.asarray(seen.T, dtype=jnp.float32), columns=True)
    np.testing.assert_allclose(columns.T, expected)


def test_normalised_values_are_standard_deviations_from_the_mean():
    """Beyond ten they are cut; a value that never varied counts as varying by 0.0001."""
    normaliser = inference.Normaliser(
        np.array([0.5, 0.2, 0.0]), np.array([0.04, 0.25, 0.0]), np.float32(1.0)
    )
    seen = np.array([[0.9, 0.2, 0.0], [3.0, -6.0, 1e-4], [0.5, 6.0, -5e-4]])
    expected = [[2.0, 0.0, 0.0], [10.0, -10.0, 1.0], [0.0, 10.0, -5.0]]
    np.testing.assert_allclose(inference.normalise(normaliser, seen), expected, rtol=1e-6)


def test_before_any_data_observations_count_as_uniform():
    """Of [0, 1]: mean 1/2, variance 1/12; a thousandth of one observation."""
    first = network.initial_normaliser(3)
    assert first.mean.tolist() == [0.5] * 3
    assert first.variance.tolist() == pytest.approx([1.0 / 12.0] * 3)
    assert float(first.count) == pytest.approx(1e-3)
