"""Asking a network: the same few lines for numpy (a policy from disk) and JAX (while learning).

Imports neither: a policy file needs numpy alone.
"""

from typing import Any, NamedTuple

Layers = tuple[tuple[Any, Any], ...]
"""(weights, biases) of each layer: JAX arrays while learning, numpy arrays in a loaded policy."""


class Normaliser(NamedTuple):
    """Running mean and variance of every observed value; part of the policy."""

    mean: Any
    variance: Any
    count: Any


CLIP = 10.0
"""Normalised values beyond this many standard deviations are cut."""
SMALLEST_VARIANCE = 1e-8
"""Added to a variance before its root is taken."""


def forward(layers: Layers, observation: Any) -> Any:
    """The network's output for observations `[..., observation]`, in numpy or in JAX."""
    value = observation
    for index, (weights, biases) in enumerate(layers):
        value = value @ weights + biases.reshape((1,) * (value.ndim - 1) + biases.shape)
        if index < len(layers) - 1:
            value = value.clip(0.0)
    return value


def normalise(normaliser: Normaliser, observation: Any) -> Any:
    """Centred and scaled observations `[..., observation]`, in numpy or in JAX."""
    shape = (1,) * (observation.ndim - 1) + normaliser.mean.shape
    mean, variance = normaliser.mean.reshape(shape), normaliser.variance.reshape(shape)
    return ((observation - mean) / (variance + SMALLEST_VARIANCE) ** 0.5).clip(-CLIP, CLIP)
