"""The forward pass and the observation normaliser, for numpy (inference) and JAX (training).

Imports neither library, so inference from a policy file needs numpy only.
"""

from typing import Any, NamedTuple

Layers = tuple[tuple[Any, Any], ...]
"""(weights, biases) of each layer: JAX arrays in training, numpy arrays in a loaded policy."""


class Normaliser(NamedTuple):
    """Running mean and variance of each observed value. Part of the policy."""

    mean: Any
    variance: Any
    count: Any


CLIP = 10.0
"""Normalised values are clipped to this many standard deviations."""
SMALLEST_VARIANCE = 1e-8
"""Added to the variance before taking the square root."""


def forward(layers: Layers, observation: Any, columns: bool = False) -> Any:
    """The network's output, in numpy or JAX.

    Observations are `[..., observation]` or, with `columns`, `[observation, samples]`, so that
    samples are contiguous in memory.
    """
    value, library = observation, observation.__array_namespace__()
    for index, (weights, biases) in enumerate(layers):
        product = weights.T @ value if columns else value @ weights
        value = product + _broadcast(biases, value.ndim, columns)
        if index < len(layers) - 1:
            value = library.maximum(value, 0.0)
    return value


def normalise(normaliser: Normaliser, observation: Any, columns: bool = False) -> Any:
    """Normalised observations, in numpy or JAX. The shapes are those of `forward`."""
    mean, variance = (
        _broadcast(values, observation.ndim, columns)
        for values in (normaliser.mean, normaliser.variance)
    )
    return ((observation - mean) / (variance + SMALLEST_VARIANCE) ** 0.5).clip(-CLIP, CLIP)


def _broadcast(values: Any, axes: int, columns: bool) -> Any:
    """A vector reshaped to `axes` axes, along the last axis or, with `columns`, the first."""
    if axes == 1:
        return values
    others = (1,) * (axes - 1)
    return values.reshape((*values.shape, *others) if columns else (*others, *values.shape))
