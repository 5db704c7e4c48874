"""Routes that end at an airport inside the area: where a flight has landed."""

import numpy as np
from jaxtyping import Float

LANDING_NM = 5.0
"""A flight has landed within this distance of the last fix of its route, if that is inside the
area. It is BluebirdDT's distance."""
SIDES = 16
"""The number of sides of the polygon that replaces the circle."""
RING_NM = 5.1
"""The distance of its corners from the airport, rounded up."""


def is_inside(point: Float[np.ndarray, "2"], area: Float[np.ndarray, "vertices 2"]) -> bool:
    """Whether a point is inside a polygon.

    It is if a line from it to the east crosses the boundary an odd number of times. In numpy,
    because tables of sectors are also made while JAX traces a program.
    """
    start, end = area, np.roll(area, -1, axis=0)
    crossed = (start[:, 1] > point[1]) != (end[:, 1] > point[1])
    start, end = start[crossed], end[crossed]
    fraction = (point[1] - start[:, 1]) / (end[:, 1] - start[:, 1])
    east = start[:, 0] + fraction * (end[:, 0] - start[:, 0])
    return bool(np.sum(east > point[0]) % 2)


def landing_ring(centre: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "points 2"]:
    """A closed polygon around a circle, clockwise, so that the outside is to its left."""
    turn = 2.0 * np.pi / SIDES * np.arange(SIDES + 1)
    corner = radius / np.cos(np.pi / SIDES)
    return centre + corner * np.stack([np.sin(turn), np.cos(turn)], axis=1)


def landing_ends(
    centre: Float[np.ndarray, "2"], before: Float[np.ndarray, "2"], radius: float
) -> Float[np.ndarray, "2 2"]:
    """The ends of the circle's diameter across the last leg, on its right and on its left."""
    east, north = (centre - before) / np.hypot(*(centre - before))
    right = radius * np.array([north, -east])
    return np.stack([centre + right, centre - right])
