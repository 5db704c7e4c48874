"""Pairs of aircraft: the features that a policy can observe, and predicted closest approaches.

Predictions assume that all aircraft fly straight along their *cleared* headings at their current
ground speeds: what would happen "even if no further instructions are issued" (paper). Only
`turn_miss` and `turn_time` include the turns to these headings.
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
from skystack.tasks.pair_turns import Turning, closest_with_turns, turning

RANGE_NM = 150.0
"""d_max: the distance over which the faster aircraft of a pair is predicted. Pairs further apart
have no safety reward."""

SAME_VELOCITY_KT = 0.01
"""Slower relative motion is rounding: its direction depends on the processor."""

PerPair = Float[Array, "pairs *batch"]


class Pairs(NamedTuple):
    """All pairs of aircraft, the one with the lower index first. Vectors are (east, north)."""

    offset_nm: Float[Array, "pairs 2 *batch"]
    """From the first to the second, in true length with the scale at the midpoint."""
    velocity_kt: Float[Array, "pairs 2 *batch"]
    """The velocity of the second relative to the first, on cleared headings."""
    horizon_h: PerPair
    """The time in which the faster aircraft flies `RANGE_NM`."""
    first_heading_deg: PerPair
    """The cleared heading of the first."""
    second_heading_deg: PerPair
    """The cleared heading of the second."""
    active: Bool[Array, "pairs *batch"]
    """Whether both are active."""
    first_turn: Turning
    """The turn of the first to its cleared heading."""
    second_turn: Turning
    """That of the second."""

    @property
    def distance_nm(self) -> PerPair:
        return length(self.offset_nm)

    @property
    def closest_nm(self) -> PerPair:
        """d_s: the predicted closest approach within the horizon, in closed form."""
        return closest_approach(
            self.offset_nm, self.velocity_kt, jnp.zeros_like(self.horizon_h), self.horizon_h
        )


def pairs_of(plane: MercatorPlane, traffic: Traffic) -> Pairs:
    """All pairs of aircraft of the traffic."""
    speed = traffic.ground_speed_kt
    position, other_position = first_and_second(traffic.position_nm)
    velocity, other_velocity = first_and_second(
        speed[:, None] * direction(traffic.cleared_heading_deg)
    )
    turns = turning(traffic)
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
        first_turn=Turning(*(first_and_second(values)[0] for values in turns)),
        second_turn=Turning(*(first_and_second(values)[1] for values in turns)),
    )


class PairFeature(NamedTuple):
    """A feature of a pair: its function, its range and its description."""

    value: Callable[[Pairs], PerPair]
    low: float
    """The value that is scaled to 0."""
    high: float
    """The value that is scaled to 1."""
    gone: float
    """The value for a pair with an inactive aircraft."""
    meaning: str


def turn_to_second(pairs: Pairs) -> PerPair:
    return wrap_180(bearing(pairs.offset_nm) - pairs.first_heading_deg)


def turn_to_first(pairs: Pairs) -> PerPair:
    return wrap_180(bearing(-pairs.offset_nm) - pairs.second_heading_deg)


def track_difference(pairs: Pairs) -> PerPair:
    return wrap_180(pairs.second_heading_deg - pairs.first_heading_deg)


def signed_miss(pairs: Pairs) -> PerPair:
    """The predicted closest approach [NM], positive if the first aircraft is to the right of the
    second's relative motion, or if there is none."""
    moving = dot(pairs.velocity_kt, pairs.velocity_kt) > SAME_VELOCITY_KT**2
    left = moving & (cross(pairs.velocity_kt, pairs.offset_nm) < 0.0)
    return jnp.where(left, -1.0, 1.0) * pairs.closest_nm


def minutes_to_closest(pairs: Pairs) -> PerPair:
    speed2 = jnp.maximum(dot(pairs.velocity_kt, pairs.velocity_kt), 1.0)
    hours = -dot(pairs.offset_nm, pairs.velocity_kt) / speed2
    return 60.0 * jnp.clip(hours, 0.0, pairs.horizon_h)


def miss_with_turns(pairs: Pairs) -> PerPair:
    return _with_turns(pairs)[0]


def minutes_with_turns(pairs: Pairs) -> PerPair:
    return 60.0 * _with_turns(pairs)[1]


def _with_turns(pairs: Pairs) -> tuple[PerPair, PerPair]:
    return closest_with_turns(
        pairs.offset_nm, pairs.first_turn, pairs.second_turn, pairs.velocity_kt, pairs.horizon_h
    )


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
    "time": PairFeature(
        minutes_to_closest, 0.0, 20.0, 20.0, "time to the closest approach, minutes"
    ),
    "turn_miss": PairFeature(
        miss_with_turns,
        0.0,
        30.0,
        30.0,
        "closest approach predicted with the turns to cleared headings flown, NM",
    ),
    "turn_time": PairFeature(
        minutes_with_turns, 0.0, 20.0, 20.0, "time to that closest approach, minutes"
    ),
}
"""The paper's features are `theta` and `d` (theta_12, d_12). skystack adds the others."""


def observe_pairs(
    names: tuple[str, ...], plane: MercatorPlane, traffic: Traffic
) -> Float[Array, "observation *batch"]:
    """The named features in [0, 1], pair by pair."""
    pairs, columns = subroutine(partial(pairs_of, plane), traffic), []
    for name in names:
        feature = PAIR_FEATURES[name]
        observed = jnp.where(pairs.active, subroutine(feature.value, pairs), feature.gone)
        columns.append((observed - feature.low) / (feature.high - feature.low))
    observation = jnp.clip(jnp.stack(columns, axis=1), 0.0, 1.0)
    return observation.reshape(-1, *observation.shape[2:])


def pair_names(names: tuple[str, ...], aircraft: int) -> tuple[str, ...]:
    """`theta_12`, `d_12`, `theta_13`, ... in the order of `observe_pairs`."""
    return tuple(
        f"{name}_{first + 1}{second + 1}"
        for first in range(aircraft)
        for second in range(first + 1, aircraft)
        for name in names
    )
