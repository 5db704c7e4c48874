"""Plane geometry on JAX arrays: angles, routes as polylines, areas, closest approach.

Positions are NM in the sector's plane, `[..., 2]` as (east, north); angles are compass degrees.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def wrap_180(angle_deg: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The same angle in [-180, 180): float32 rounds just below -180 to 180, which is -180."""
    wrapped = jnp.mod(angle_deg + 180.0, 360.0) - 180.0
    return jnp.where(wrapped >= 180.0, -180.0, wrapped)


def wrap_360(angle_deg: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The same angle in [0, 360): float32 rounds a tiny negative angle to 360, which is 0."""
    wrapped = jnp.mod(angle_deg, 360.0)
    return jnp.where(wrapped >= 360.0, 0.0, wrapped)


def direction(heading_deg: Float[Array, "*n"]) -> Float[Array, "*n 2"]:
    """Unit vectors of compass headings."""
    radians = jnp.radians(heading_deg)
    return jnp.stack([jnp.sin(radians), jnp.cos(radians)], axis=-1)


def bearing(offset_nm: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
    """Compass bearing [deg, -180 to 180] of a displacement; 0 for none."""
    return jnp.degrees(jnp.arctan2(offset_nm[..., 0], offset_nm[..., 1]))


def cross(a: Float[Array, "*n 2"], b: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
    """Twice the area spanned: positive where `b` points to the left of `a`."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def distance_right_of_route(
    position_nm: Float[Array, "aircraft 2"], fixes_nm: Float[Array, "aircraft fixes 2"]
) -> Float[Array, " aircraft"]:
    """Distance [NM] to the nearest point of a polyline, positive to the right of its direction.

    A route shorter than the array repeats its last fix: legs without length do not count.
    """
    start, leg = fixes_nm[:, :-1], jnp.diff(fixes_nm, axis=1)
    offset = position_nm[:, None, :] - start
    length2 = jnp.sum(leg * leg, axis=-1)
    along = jnp.clip(jnp.sum(offset * leg, axis=-1) / jnp.maximum(length2, 1e-9), 0.0, 1.0)
    gap = offset - along[..., None] * leg
    distance2 = jnp.where(length2 > 0.0, jnp.sum(gap * gap, axis=-1), jnp.inf)
    nearest = distance2 <= jnp.min(distance2, axis=-1, keepdims=True)
    # Where two legs are equally near (at their common fix) the first one tells the side.
    first = nearest & (jnp.cumsum(nearest, axis=-1) == 1)
    side = jnp.sum(jnp.where(first, jnp.where(cross(leg, offset) > 0.0, -1.0, 1.0), 0.0), axis=-1)
    return side * jnp.sqrt(jnp.min(distance2, axis=-1))


def inside_area(
    position_nm: Float[Array, "aircraft 2"], area_nm: Float[Array, "vertices 2"]
) -> Bool[Array, " aircraft"]:
    """Whether points lie in a simple polygon: even-odd rule, a ray to the east."""
    x, y = position_nm[:, None, 0], position_nm[:, None, 1]
    ax, ay = area_nm[None, :, 0], area_nm[None, :, 1]
    bx, by = jnp.roll(ax, -1, axis=1), jnp.roll(ay, -1, axis=1)
    spans = (ay > y) != (by > y)
    rise = jnp.where(by == ay, 1.0, by - ay)
    crossing_x = ax + (y - ay) * (bx - ax) / rise
    return jnp.sum(spans & (x < crossing_x), axis=1) % 2 == 1


def crosses_outward(
    before_nm: Float[Array, "aircraft 2"],
    after_nm: Float[Array, "aircraft 2"],
    edge_nm: Float[Array, "aircraft 2 2"],
) -> Bool[Array, " aircraft"]:
    """Whether the segment flown crosses an edge from its left to its right.

    Areas are listed counter-clockwise, so that left of an edge is inside.
    """
    start, end = edge_nm[:, 0], edge_nm[:, 1]
    edge, flown = end - start, after_nm - before_nm
    left_before = cross(edge, before_nm - start) >= 0.0
    right_after = cross(edge, after_nm - start) < 0.0
    between = (cross(flown, start - before_nm) <= 0.0) & (cross(flown, end - before_nm) >= 0.0)
    return left_before & right_after & between


def closest_approach(
    offset_nm: Float[Array, "*n 2"],
    velocity: Float[Array, "*n 2"],
    from_time: Float[Array, "*n"],
    until_time: Float[Array, "*n"],
) -> Float[Array, "*n"]:
    """Least distance [NM] of a point in straight relative motion within a span of time.

    `velocity` is NM per unit of the times. A span that ends before it begins gives infinity.
    """
    speed2 = jnp.sum(velocity * velocity, axis=-1)
    approach = -jnp.sum(offset_nm * velocity, axis=-1) / jnp.where(speed2 > 0.0, speed2, 1.0)
    time = jnp.clip(approach, from_time, until_time)
    nearest = offset_nm + time[..., None] * velocity
    distance = jnp.sqrt(jnp.sum(nearest * nearest, axis=-1))
    return jnp.where(until_time >= from_time, distance, jnp.inf)
