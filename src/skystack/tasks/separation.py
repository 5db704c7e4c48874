"""Separation: the minimum distance between aircraft that are not separated vertically."""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from skystack.airspace.geometry import Components, closest_approach_squared, first_and_second
from skystack.airspace.projection import MercatorPlane
from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.progress import Progress


class Separation(NamedTuple):
    """The separation in a scenario. Infinite before the first cycle."""

    last_nm: Float[Array, "*batch"]
    """The separation in the last cycle, see `separation_nm`."""
    least_nm: Float[Array, "*batch"]
    """The minimum separation in all cycles so far."""


def begin_separation(traffic: Traffic) -> Separation:
    """The separation at cycle 0."""
    infinite = jnp.zeros(traffic.level_ticks.shape[1:], dtype=jnp.float32) + jnp.inf
    return Separation(infinite, infinite)


def update_separation(separation: Separation, last_nm: Float[Array, "*batch"]) -> Separation:
    """The separation after a cycle in which it was `last_nm`."""
    return Separation(last_nm, jnp.minimum(separation.least_nm, last_nm))


def separation_nm(sector: Sector, progress: Progress, traffic: Traffic) -> Float[Array, "*batch"]:
    """Minimum distance [NM] in the last cycle of two active aircraft without vertical separation.

    Closed form for straight motion from one radar position to the next; a turn deviates from it by
    less than 0.02 NM. Infinite if all pairs were separated vertically.
    """
    if traffic.level_ticks.shape[0] < 2:
        return jnp.full_like(progress.cycles, jnp.inf)
    squared = pair_distance_squared(
        sector.plane,
        sector.separation_fl,
        progress.previous_nm,
        traffic.position_nm,
        progress.previous_level_ticks,
        traffic.level_ticks,
    )
    first_active, second_active = first_and_second(traffic.active)
    # One root of the minimum: a root for every pair would double the cost.
    return jnp.sqrt(jnp.min(jnp.where(first_active & second_active, squared, jnp.inf), axis=0))


def pair_distance_squared(
    plane: MercatorPlane,
    separation_fl: int,
    previous_nm: Float[ArrayLike, "aircraft 2 *batch"],
    position_nm: Float[ArrayLike, "aircraft 2 *batch"],
    previous_level_ticks: Float[ArrayLike, "aircraft *batch"],
    level_ticks: Float[ArrayLike, "aircraft *batch"],
) -> Float[Array, "pairs *batch"]:
    """Square [NM2] of the minimum distance of each pair in a cycle, as in `separation_nm`.

    Only times at which the two are less than `separation_fl` apart vertically count. Whether there
    are any is decided on whole ticks, which are exact in float32, so compiled and eager code agree.
    """

    def difference(values: ArrayLike) -> Array:
        first, second = first_and_second(jnp.asarray(values))
        return first - second

    def true_offset(position_nm: ArrayLike) -> Components:
        at = jnp.asarray(position_nm)
        # The mean of 1 / scale at both ends replaces that at the midpoint. For aircraft 20 NM apart
        # at 75 N the error is at most one part in ten thousand. The scale is computed in a
        # subroutine; otherwise XLA would compute it for every pair.
        first_half, second_half = first_and_second(
            subroutine(partial(half_length, plane), at[:, 1])
        )
        length = first_half + second_half
        return Components(difference(at[:, 0]) * length, difference(at[:, 1]) * length)

    offset = true_offset(previous_nm)
    motion = true_offset(position_nm).minus(offset)
    gap, gap_after = difference(previous_level_ticks), difference(level_ticks)
    return least_distance_squared(offset, motion, gap, gap_after, ticks(separation_fl))


def least_distance_squared(
    offset_nm: Components,
    motion_nm: Components,
    gap: Float[Array, "pairs *batch"],
    gap_after: Float[Array, "pairs *batch"],
    limit: float,
) -> Float[Array, "pairs *batch"]:
    """Square [NM2] of the minimum distance in a cycle while the vertical gap is below a limit.

    `offset_nm` is the offset before the cycle and `motion_nm` its change, both in true length; the
    gaps are those before and after the cycle, in ticks like the limit. Infinite if the gap is never
    below the limit.
    """
    crosses = (gap > 0.0) != (gap_after > 0.0)  # one aircraft passes through the other's level
    close = crosses | (jnp.minimum(jnp.abs(gap), jnp.abs(gap_after)) < limit)
    # The part of the cycle, from 0 to 1, in which |gap + climb * time| < limit, if there is any.
    climb = gap_after - gap
    time_per_tick = 1.0 / jnp.where(climb == 0.0, 1.0, climb)
    low, high = (-limit - gap) * time_per_tick, (limit - gap) * time_per_tick
    begins = jnp.maximum(jnp.minimum(low, high), 0.0)
    ends = jnp.minimum(jnp.maximum(low, high), 1.0)
    return jnp.where(close, closest_approach_squared(offset_nm, motion_nm, begins, ends), jnp.inf)


def half_length(plane: MercatorPlane, north_nm: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Half the true length [NM] of a unit of the plane."""
    return 0.5 / plane.scale(north_nm)
