"""Plane geometry on JAX arrays: angles, routes as polylines, areas, closest approach.

Positions are in NM in the sector's plane, angles in compass degrees. A point or vector is
`[n, 2, *batch]` with the components (east, north) along axis 1. Batch axes come last, because
arithmetic along the last axis is fastest. The legs of a route and the edges of an area are unrolled
instead of being an array axis, so the compiler fuses them into one loop without intermediate
arrays.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

MAX_UNROLLED = 64
"""Areas with at most this many edges are unrolled in compiled programs. Larger areas use a loop,
with the same result."""
AnyArray = TypeVar("AnyArray", Array, np.ndarray)


class Components(NamedTuple):
    """Vectors as one array for each component.

    If both components are in one array, XLA repeats all preceding computations for each component
    that is used, and does not vectorise them. With separate components, long expressions run
    several times as fast.
    """

    east: Float[Array, "*n"]
    north: Float[Array, "*n"]

    @classmethod
    def of(cls, vectors: Float[Array, "n 2 *batch"]) -> "Components":
        return cls(vectors[:, 0], vectors[:, 1])

    def dot(self, other: "Components") -> Float[Array, "*n"]:
        """The dot product."""
        return self.east * other.east + self.north * other.north

    def minus(self, other: "Components") -> "Components":
        return Components(self.east - other.east, self.north - other.north)

    def ahead(self, velocity: "Components", time: Float[Array, "*n"]) -> "Components":
        """The position after straight motion from here."""
        return Components(self.east + time * velocity.east, self.north + time * velocity.north)


def wrap_180(angle_deg: Float[AnyArray, "*n"]) -> Float[AnyArray, "*n"]:
    """The same angle in [-180, 180), in JAX or numpy.

    In float32 an angle just below -180 wraps to exactly 180, which is returned as -180.
    """
    library: Any = angle_deg.__array_namespace__()
    wrapped = angle_deg - 360.0 * library.floor((angle_deg + 180.0) / 360.0)
    return library.where(wrapped >= 180.0, -180.0, library.maximum(wrapped, -180.0))


def wrap_360(angle_deg: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The same angle in [0, 360).

    In float32 a tiny negative angle wraps to exactly 360, which is returned as 0.
    """
    wrapped = angle_deg - 360.0 * jnp.floor(angle_deg / 360.0)
    return jnp.where(wrapped >= 360.0, 0.0, jnp.maximum(wrapped, 0.0))


def direction(heading_deg: Float[Array, "n *batch"]) -> Float[Array, "n 2 *batch"]:
    """Unit vectors (east, north) of compass headings."""
    radians = jnp.radians(heading_deg)
    return jnp.stack([jnp.sin(radians), jnp.cos(radians)], axis=1)


def bearing(offset_nm: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """Compass bearing [deg, -180 to 180] of a displacement; 0 for a zero displacement."""
    return jnp.degrees(jnp.arctan2(offset_nm[:, 0], offset_nm[:, 1]))


def cross(a: Float[Array, "n 2 *batch"], b: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """The cross product: positive where `b` points to the left of `a`."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def dot(a: Float[Array, "n 2 *batch"], b: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """The dot product."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


def length(vector: Float[Array, "n 2 *batch"]) -> Float[Array, "n *batch"]:
    """The length of each vector."""
    return jnp.sqrt(dot(vector, vector))


def distance_right_of_route(
    position_nm: Float[Array, "aircraft 2 *batch"],
    fixes_nm: Sequence[Float[Array, "aircraft 2 *batch"]],
    bulges_nm: Sequence[Float[Array, "aircraft *batch"]] = (),
) -> Float[Array, "aircraft *batch"]:
    """Distance [NM] to the nearest point of a polyline, positive to the right of its direction.

    Shorter routes are padded with their last fix; legs of zero length are ignored. Where two legs
    are equally near (at their common fix), the first leg determines the side. With `bulges_nm`,
    each leg is a flat arc whose midpoint is that far to the right of the straight leg.
    """
    least2 = jnp.full_like(position_nm[:, 0], jnp.inf)
    side = jnp.ones_like(least2)
    for number, (start, end) in enumerate(pairwise(fixes_nm)):
        leg, offset = end - start, position_nm - start
        length2 = dot(leg, leg)
        along = jnp.clip(dot(offset, leg) / jnp.maximum(length2, 1e-9), 0.0, 1.0)
        gap = offset - along[:, None] * leg
        if bulges_nm:
            bulge = 4.0 * along * (1.0 - along) * bulges_nm[number]
            bulge = bulge / jnp.sqrt(jnp.maximum(length2, 1e-9))
            gap -= bulge[:, None] * jnp.stack([leg[:, 1], -leg[:, 0]], axis=1)
            offset = gap
        distance2 = jnp.where(length2 > 0.0, dot(gap, gap), jnp.inf)
        nearer = distance2 < least2
        least2 = jnp.where(nearer, distance2, least2)
        side = jnp.where(nearer, jnp.where(cross(leg, offset) > 0.0, -1.0, 1.0), side)
    return side * jnp.sqrt(least2)


def edges(area_nm: Float[np.ndarray, "vertices 2"]) -> Float[np.ndarray, "vertices 2 2"]:
    """The edges of a polygon in its order, each as start and end, rounded to float32."""
    corners = area_nm.astype(np.float32).astype(np.float64)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def inside_area(
    position_nm: Float[Array, "aircraft 2 *batch"], area_nm: Float[np.ndarray, "vertices 2"]
) -> Bool[Array, "aircraft *batch"]:
    """Whether points are inside a simple polygon, by the even-odd rule with a ray to the east."""
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

    if len(rows) > MAX_UNROLLED:  # unrolling would take minutes and gigabytes to compile
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
    """Whether the flown segment crosses an edge from left to right.

    Areas are counter-clockwise, so the left side of an edge is inside.
    """
    edge, flown = end - start, after_nm - before_nm
    left_before = cross(edge, before_nm - start) >= 0.0
    right_after = cross(edge, after_nm - start) < 0.0
    between = (cross(flown, start - before_nm) <= 0.0) & (cross(flown, end - before_nm) >= 0.0)
    return left_before & right_after & between


def first_and_second(values: Array) -> tuple[Array, Array]:
    """The rows of the first and of the second aircraft of every pair: `[pairs, ...]` each."""
    count = values.shape[0]
    if count == 2:  # a gather would cost more than all later work on the rows
        return values[:1], values[1:]
    first, second = np.triu_indices(count, k=1)
    return values[first], values[second]


def closest_approach(
    offset_nm: Float[Array, "n 2 *batch"],
    velocity: Float[Array, "n 2 *batch"],
    from_time: Float[Array, "n *batch"],
    until_time: Float[Array, "n *batch"],
) -> Float[Array, "n *batch"]:
    """Minimum distance [NM] of a point in straight motion from the origin, in a time interval.

    `velocity` is in NM per unit of the times. The result is infinite for an empty interval
    (`until_time` before `from_time`).
    """
    offset, motion = Components.of(offset_nm), Components.of(velocity)
    squared = closest_approach_squared(offset, motion, from_time, until_time)
    return jnp.where(until_time >= from_time, jnp.sqrt(squared), jnp.inf)


def closest_approach_squared(
    offset_nm: Components,
    velocity: Components,
    from_time: Float[Array, "n *batch"],
    until_time: Float[Array, "n *batch"],
) -> Float[Array, "n *batch"]:
    """The square [NM2] of `closest_approach`. The interval must not be empty."""
    speed2 = velocity.dot(velocity)
    approach = -offset_nm.dot(velocity) / jnp.where(speed2 > 0.0, speed2, 1.0)
    nearest = offset_nm.ahead(velocity, jnp.clip(approach, from_time, until_time))
    return nearest.dot(nearest)


def value_of(values: np.ndarray, index: Int[Array, "n *batch"]) -> Array:
    """Values of a constant table `[entries]`. The index must be within bounds."""
    table = jnp.asarray(values)
    return table.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def points_of(
    points: Float[np.ndarray, "entries points 2"], index: Int[Array, "n *batch"]
) -> list[Float[Array, "n 2 *batch"]]:
    """Entries of a constant table of point sequences, as one array per point of the sequence.

    Used for the fixes of routes, for example. The index must be within bounds.
    """
    return [point_of(points[:, number], index) for number in range(points.shape[1])]


def point_of(
    points: Float[np.ndarray, "entries 2"], index: Int[Array, "n *batch"]
) -> Float[Array, "n 2 *batch"]:
    """Points of a constant table. The index must be within bounds."""
    return jnp.stack([value_of(points[:, axis], index) for axis in range(2)], axis=1)
