"""Pairs of aircraft: what a policy can be shown of them, and how near they are predicted to come.

Predictions fly everybody straight on along their *cleared* headings at their present ground speeds:
what would happen "even if no further instructions are issued".
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from skystack.airspace.geometry import (
    bearing,
    closest_approach,
    cross,
    direction,
    dot,
    first_and_second,
    length,
    wrap_180,
)
from skystack.airspace.projection import MercatorPlane
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import Traffic

RANGE_NM = 150.0
"""d_max: how far the faster of a pair is flown ahead; pairs farther apart are no matter."""

PerPair = Float[Array, "pairs *batch"]


class Pairs(NamedTuple):
    """Every two aircraft, the first the one of the lower number; east and north."""

    offset_nm: Float[Array, "pairs 2 *batch"]
    """From the first to the second, in true lengths: the scale is that half-way."""
    velocity_kt: Float[Array, "pairs 2 *batch"]
    """Of the second as seen from the first, on cleared headings."""
    horizon_h: PerPair
    """Until the faster has flown `RANGE_NM`."""
    first_heading_deg: PerPair
    """Cleared."""
    second_heading_deg: PerPair
    active: Bool[Array, "pairs *batch"]
    """Both are."""

    @property
    def distance_nm(self) -> PerPair:
        return length(self.offset_nm)

    @property
    def closest_nm(self) -> PerPair:
        """d_s: the predicted closest approach within the horizon, closed form."""
        return closest_approach(
            self.offset_nm, self.velocity_kt, jnp.zeros_like(self.horizon_h), self.horizon_h
        )


def pairs_of(plane: MercatorPlane, traffic: Traffic) -> Pairs:
    """All pairs of the traffic's aircraft."""
    speed = traffic.ground_speed_kt
    position, other_position = first_and_second(traffic.position_nm)
    velocity, other_velocity = first_and_second(
        speed[:, None] * direction(traffic.cleared_heading_deg)
    )
    scale = plane.scale((position[:, 1] + other_position[:, 1]) / 2.0)
    heading, other_heading = first_and_second(traffic.cleared_heading_deg)
    active, other_active = first_and_second(traffic.active)
    return Pairs(
        offset_nm=(other_position - position) / scale[:, None],
        velocity_kt=other_velocity - velocity,
        horizon_h=RANGE_NM / jnp.maximum(*first_and_second(speed)),
        first_heading_deg=heading,
        second_heading_deg=other_heading,
        active=active & other_active,
    )


class PairFeature(NamedTuple):
    """How to compute a value, the range that maps to [0, 1], and what a pair shows without one."""

    value: Callable[[Pairs], PerPair]
    low: float
    high: float
    gone: float
    meaning: str


def turn_to_second(pairs: Pairs) -> PerPair:
    return wrap_180(bearing(pairs.offset_nm) - pairs.first_heading_deg)


def turn_to_first(pairs: Pairs) -> PerPair:
    return wrap_180(bearing(-pairs.offset_nm) - pairs.second_heading_deg)


def track_difference(pairs: Pairs) -> PerPair:
    return wrap_180(pairs.second_heading_deg - pairs.first_heading_deg)


def signed_miss(pairs: Pairs) -> PerPair:
    """How far the second passes from the first; positive to the right of the relative motion."""
    return jnp.where(cross(pairs.velocity_kt, pairs.offset_nm) < 0.0, -1.0, 1.0) * pairs.closest_nm


def minutes_to_closest(pairs: Pairs) -> PerPair:
    speed2 = jnp.maximum(dot(pairs.velocity_kt, pairs.velocity_kt), 1.0)
    hours = -dot(pairs.offset_nm, pairs.velocity_kt) / speed2
    return 60.0 * jnp.clip(hours, 0.0, pairs.horizon_h)


PAIR_FEATURES: dict[str, PairFeature] = {
    "theta": PairFeature(
        turn_to_second, -180.0, 180.0, 0.0, "turn from the first's cleared heading to the second"
    ),
    "d": PairFeature(lambda pairs: pairs.distance_nm, 0.0, RANGE_NM, RANGE_NM, "distance, NM"),
    "theta_back": PairFeature(
        turn_to_first, -180.0, 180.0, 0.0, "turn from the second's cleared heading to the first"
    ),
    "track": PairFeature(
        track_difference, -180.0, 180.0, 0.0, "the second's cleared heading minus the first's"
    ),
    "miss": PairFeature(signed_miss, -30.0, 30.0, 30.0, "predicted closest approach, signed, NM"),
    "time": PairFeature(minutes_to_closest, 0.0, 20.0, 20.0, "minutes until it"),
}
"""The paper's are `theta` and `d` (theta_12, d_12); the others are ours."""


def observe_pairs(
    names: tuple[str, ...], plane: MercatorPlane, traffic: Traffic
) -> Float[Array, "observation *batch"]:
    """The named features, pair by pair, in [0, 1]."""
    pairs, columns = subroutine(partial(pairs_of, plane), traffic), []
    for name in names:
        feature = PAIR_FEATURES[name]
        shown = jnp.where(pairs.active, subroutine(feature.value, pairs), feature.gone)
        columns.append((shown - feature.low) / (feature.high - feature.low))
    shown = jnp.clip(jnp.stack(columns, axis=1), 0.0, 1.0)
    return shown.reshape(-1, *shown.shape[2:])


def pair_names(names: tuple[str, ...], aircraft: int) -> tuple[str, ...]:
    """`theta_12`, `d_12`, `theta_13`, ... in the order of `observe_pairs`."""
    return tuple(
        f"{name}_{first + 1}{second + 1}"
        for first in range(aircraft)
        for second in range(first + 1, aircraft)
        for name in names
    )
