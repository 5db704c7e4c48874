"""Plane geometry on JAX arrays: angles, routes as polylines, areas, closest approach.

Positions are NM in the sector's plane, angles are compass degrees. A point or vector is
`[n, 2, *batch]`, its components (east, north) along axis 1; whatever axes follow are a batch, and a
batch along the last axis is computed fastest. For that reason too the legs of a route and the edges
of an area are written out one after the other, not as an axis: the compiler then makes one loop of
it all, without arrays in between.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

MOST_UNROLLED = 64
"""Most edges of an area to unroll in compiled programs; longer ones become a loop, same result."""


def wrap_180(angle_deg: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The same angle in [-180, 180): float32 rounds just below -180 to 180, which is -180."""
    wrapped = angle_deg - 360.0 * jnp.floor((angle_deg + 180.0) / 360.0)
    return jnp.where(wrapped >= 180.0, -180.0, jnp.maximum(wrapped, -180.0))


def wrap_360(angle_deg: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The same angle in [0, 360): float32 rounds a tiny negative angle to 360, which is 0."""
    wrapped = angle_deg - 360.0 * jnp.floor(angle_deg / 360.0)
    return jnp.where(wrapped >= 360.0, 0.0, jnp.maximum(wrapped, 0.0))


def direction(heading_deg: Float[Array, "n *batch"]) -> Float[Array, "n 2 *batch"]:
    """Unit vectors of compass headings."""
    radians = jnp.radians(heading_deg)
    return jnp.stack([jnp.sin(radians), jnp.cos(radians)], axis=1)


def bearing(offset_nm: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """Compass bearing [deg, -180 to 180] of a displacement; 0 for none."""
    return jnp.degrees(jnp.arctan2(offset_nm[:, 0], offset_nm[:, 1]))


def cross(a: Float[Array, "n 2 *batch"], b: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """Twice the area spanned: positive where `b` points to the left of `a`."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def dot(a: Float[Array, "n 2 *batch"], b: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """Product of the lengths and of the cosine between."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


def length(vector: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """Length of vectors."""
    return jnp.sqrt(dot(vector, vector))


def distance_right_of_route(
    position_nm: Float[Array, "aircraft 2 *batch"],
    fixes_nm: Sequence[Float[Array, "aircraft 2 *batch"]],
    bulges_nm: Sequence[Float[Array, "aircraft *batch"]] = (),
) -> Float[Array, "aircraft *batch"]:
    """Distance [NM] to the nearest point of a polyline, positive to the right of its direction.

    A route shorter than the others repeats its last fix: legs without length do not count. Where
    two legs are equally near (at their common fix) the first one decides the side. With `bulges_nm`
    legs are flat arcs, their middle so far to the right of the straight line.
    """
    least2 = jnp.full_like(position_nm[:, 0], jnp.inf)
    side = jnp.ones_like(least2)
    for number, (start, end) in enumerate(pairwise(fixes_nm)):
        leg, offset = end - start, position_nm - start
        length2 = dot(leg, leg)
        along = jnp.clip(dot(offset, leg) / jnp.maximum(length2, 1e-9), 0.0, 1.0)
        gap = offset - along[:, None] * leg
        if bulges_nm:
            aside = 4.0 * along * (1.0 - along) * bulges_nm[number]
            aside = aside / jnp.sqrt(jnp.maximum(length2, 1e-9))
            gap -= aside[:, None] * jnp.stack([leg[:, 1], -leg[:, 0]], axis=1)
            offset = gap
        distance2 = jnp.where(length2 > 0.0, dot(gap, gap), jnp.inf)
        nearer = distance2 < least2
        least2 = jnp.where(nearer, distance2, least2)
        side = jnp.where(nearer, jnp.where(cross(leg, offset) > 0.0, -1.0, 1.0), side)
    return side * jnp.sqrt(least2)


def edges(area_nm: Float[np.ndarray, "vertices 2"]) -> Float[np.ndarray, "vertices 2 2"]:
    """The edges of a polygon: start and end, in its order; rounded to float32."""
    corners = area_nm.astype(np.float32).astype(np.float64)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def inside_area(
    position_nm: Float[Array, "aircraft 2 *batch"], area_nm: Float[np.ndarray, "vertices 2"]
) -> Bool[Array, "aircraft *batch"]:
    """Whether points lie in a simple polygon: even-odd rule, a ray to the east."""
    x, y = position_nm[:, 0], position_nm[:, 1]
    inside = jnp.zeros_like(x, dtype=bool)
    rows = [
        (ax, ay, by, (bx - ax) / (by - ay))
        for (ax, ay), (bx, by) in edges(area_nm).tolist()
        if ay != by
    ]

    def crossed(inside: Any, edge: Any) -> tuple[Any, None]:
        ax, ay, by, slope = edge
        spans = (y < ay) != (y < by)
        return inside ^ (spans & (x < ax + (y - ay) * slope)), None

    if len(rows) > MOST_UNROLLED:  # unrolled, it would take minutes and gigabytes to compile
        columns = tuple(np.array(column, dtype=np.float32) for column in zip(*rows, strict=True))
        looped: Bool[Array, "aircraft *batch"] = jax.lax.scan(crossed, inside, columns)[0]
        return looped
    for row in rows:
        inside, _ = crossed(inside, row)
    return inside


def crosses_outward(
    before_nm: Float[Array, "aircraft 2 *batch"],
    after_nm: Float[Array, "aircraft 2 *batch"],
    start: Float[Array, "aircraft 2 *batch"],
    end: Float[Array, "aircraft 2 *batch"],
) -> Bool[Array, "aircraft *batch"]:
    """Whether the segment flown crosses an edge, given by its ends, from its left to its right.

    Areas are listed counter-clockwise, so that left of an edge is inside.
    """
    edge, flown = end - start, after_nm - before_nm
    left_before = cross(edge, before_nm - start) >= 0.0
    right_after = cross(edge, after_nm - start) < 0.0
    between = (cross(flown, start - before_nm) <= 0.0) & (cross(flown, end - before_nm) >= 0.0)
    return left_before & right_after & between


def first_and_second(values: Array) -> tuple[Array, Array]:
    """The rows of the first and of the second aircraft of every pair: `[pairs, ...]` each."""
    count = values.shape[0]
    if count == 2:  # looking rows up costs more than all that is done with them
        return values[:1], values[1:]
    first, second = np.triu_indices(count, k=1)
    return values[first], values[second]


def closest_approach(
    offset_nm: Float[Array, "n 2 *batch"],
    velocity: Float[Array, "n 2 *batch"],
    from_time: Float[Array, "n *batch"],
    until_time: Float[Array, "n *batch"],
) -> Float[Array, "n *batch"]:
    """Least distance [NM] of a point in straight relative motion within a span of time.

    `velocity` is NM per unit of the times. A span that ends before it begins gives infinity.
    """
    squared = closest_approach_squared(offset_nm, velocity, from_time, until_time)
    return jnp.where(until_time >= from_time, jnp.sqrt(squared), jnp.inf)


def closest_approach_squared(
    offset_nm: Float[Array, "n 2 *batch"],
    velocity: Float[Array, "n 2 *batch"],
    from_time: Float[Array, "n *batch"],
    until_time: Float[Array, "n *batch"],
) -> Float[Array, "n *batch"]:
    """The square [NM2] of `closest_approach`, for spans that do not end before they begin."""
    speed2 = dot(velocity, velocity)
    approach = -dot(offset_nm, velocity) / jnp.where(speed2 > 0.0, speed2, 1.0)
    nearest = offset_nm + jnp.clip(approach, from_time, until_time)[:, None] * velocity
    return dot(nearest, nearest)


def value_of(values: np.ndarray, index: Int[Array, "n *batch"]) -> Array:
    """Entries of a constant table `[entries]`; the index must lie within it."""
    table = jnp.asarray(values)
    return table.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def points_of(
    points: Float[np.ndarray, "entries points 2"], index: Int[Array, "n *batch"]
) -> list[Float[Array, "n 2 *batch"]]:
    """Each point of the entries of a constant table, such as the fixes of routes."""
    return [point_of(points[:, number], index) for number in range(points.shape[1])]


def point_of(
    points: Float[np.ndarray, "entries 2"], index: Int[Array, "n *batch"]
) -> Float[Array, "n 2 *batch"]:
    """Points of a constant table; the index must lie within it."""
    return jnp.stack([value_of(points[:, axis], index) for axis in range(2)], axis=1)
