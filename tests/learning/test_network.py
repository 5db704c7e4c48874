"""Initial weights, the forward pass and the normalisation of observations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning import inference, network


def test_initial_weights_are_orthogonal_and_biases_zero():
    """The gain is sqrt(2) before a ReLU, 0.01 in the actor's last layer, and 1 in the critic's."""
    parameters = network.init(jax.random.key(1), 8, (16, 12), 5)
    for layers, outputs, last_gain in ((parameters.actor, 5, 0.01), (parameters.critic, 1, 1.0)):
        shapes = [weights.shape for weights, _ in layers]
        assert shapes == [(8, 16), (16, 12), (12, outputs)]
        for (weights, biases), gain in zip(layers, [2**0.5, 2**0.5, last_gain], strict=True):
            gram = (
                weights @ weights.T
                if weights.shape[0] < weights.shape[1]
                else (weights.T @ weights)
            )
            np.testing.assert_allclose(gram, gain**2 * np.eye(len(gram)), atol=1e-5)
            assert biases.tolist() == [0.0] * weights.shape[1]
    assert not np.allclose(parameters.actor[0][0], parameters.critic[0][0])


def test_forward_pass_agrees_with_a_hand_calculation():
    """One hidden layer; for the first observation its second unit is cut off at zero."""
    layers = (
        (np.array([[1.0, -1.0], [2.0, 0.5]]), np.array([0.5, -3.0])),
        (np.array([[2.0], [10.0]]), np.array([-1.0])),
    )
    seen = np.array([[1.0, 1.0], [-2.0, 4.0]])
    # Hidden units: 3.5 and -3.5 -> 0; 6.5 and 1.
    expected = [[6.0], [22.0]]
    np.testing.assert_allclose(inference.forward(layers, seen), expected)
    assert inference.forward(layers, seen[0]).tolist() == expected[0]
    in_jax = jax.tree.map(lambda value: jnp.asarray(value, dtype=jnp.float32), layers)
    columns = inference.forward(in_jax, jnp.asarray(seen.T, dtype=jnp.float32), columns=True)
    np.testing.assert_allclose(columns.T, expected)


def test_normalises_to_standard_deviations_from_the_mean():
    """Values are clipped at 10; the standard deviation of a constant counts as 0.0001."""
    normaliser = inference.Normaliser(
        np.array([0.5, 0.2, 0.0]), np.array([0.04, 0.25, 0.0]), np.float32(1.0)
    )
    seen = np.array([[0.9, 0.2, 0.0], [3.0, -6.0, 1e-4], [0.5, 6.0, -5e-4]])
    expected = [[2.0, 0.0, 0.0], [10.0, -10.0, 1.0], [0.0, 10.0, -5.0]]
    np.testing.assert_allclose(inference.normalise(normaliser, seen), expected, rtol=1e-6)


def test_initial_normaliser_assumes_uniform_observations():
    """Uniform on [0, 1]: mean 1/2, variance 1/12. It weighs a thousandth of an observation."""
    initial = network.initial_normaliser(3)
    assert initial.mean.tolist() == [0.5] * 3
    assert initial.variance.tolist() == pytest.approx([1.0 / 12.0] * 3)
    assert float(initial.count) == pytest.approx(1e-3)
