"""The expected result of one radar cycle, as closed forms in float64.

These are independent of the simulator's code: nothing is stepped, and the value of each second
follows from the state at the start of the cycle. Arrays are `[aircraft, *batch]`, possibly with
more axes before.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from skystack.simulator.fleet import Fleet
from skystack.simulator.performance import TICKS_PER_FL, ConstantPerformance, TablePerformance

SECONDS = 6
TURN_RATE_DEG_S = 1.5
MAX_BANK_DEG = 30.0
_G_NM_S2 = 9.80665 / 1852.0
_KT_PER_FT_MIN = 0.3048 * 60.0 / 1852.0

Values = Float[np.ndarray, "..."]
Rows = Any
"""A `Traffic` or a `Clearance` with numpy arrays; their declared types are JAX arrays."""


class Limits(NamedTuple):
    """The limits of a performance model, by kind of aircraft."""

    airspeed_kt: Float[np.ndarray, "kinds 3 levels"]
    """True airspeeds at the flight levels 0 to 600, in climb, level flight and descent."""
    rate_ft_min: Float[np.ndarray, " kinds"]
    ceiling: Float[np.ndarray, " kinds"]
    """Ceilings in ticks."""


def limits(model: Fleet | TablePerformance | ConstantPerformance) -> Limits:
    """The limits of a performance model."""
    tables = model.tables if isinstance(model, Fleet) else (model,)
    return Limits(
        np.stack(
            [
                each.airspeeds_kt
                if isinstance(each, TablePerformance)
                else np.full((3, 601), each.airspeed_kt)
                for each in tables
            ]
        ),
        np.array([each.rate_ft_min for each in tables]),
        np.array([getattr(each, "ceiling_fl", np.inf) * TICKS_PER_FL for each in tables]),
    )


class Expected(NamedTuple):
    """The expected end of a cycle in which the heading and the level flown to stay the same. On own
    navigation, only the speeds, rates and levels hold."""

    level_ticks: Values
    vertical_speed_ft_min: Values
    """The vertical speed in the last second."""
    speed_kt: Float[np.ndarray, "6 ..."]
    """The ground speed in each second."""
    heading_deg: Values
    along_deg: Float[np.ndarray, "6 ..."]
    """The track in each second: the heading in its middle."""


def expected(before: Rows, allowed: Limits) -> Expected:
    """The closed forms of a cycle, from the state at its start."""
    level, vertical_speed, speed = _climb(before, allowed)
    turn = before.turn_deg.astype(float)
    turned = np.sign(turn) * np.minimum(TURN_RATE_DEG_S * _seconds(turn.ndim), np.abs(turn))
    along = before.heading_deg + (turned[:-1] + turned[1:]) / 2.0
    return Expected(level, vertical_speed, speed, (before.heading_deg + turned[-1]) % 360.0, along)


def _seconds(axes: int) -> Int[np.ndarray, "7 ..."]:
    """The numbers 0 to 6 along an axis before `axes` others."""
    return np.arange(SECONDS + 1).reshape(-1, *([1] * axes))


def _climb(before: Rows, allowed: Limits) -> tuple[Values, Values, Values]:
    """Level and vertical speed at the end, and the ground speed in each second."""
    start, target = before.level_ticks.astype(float), before.flown_level_ticks.astype(float)
    to_go, sign = np.abs(target - start), np.sign(target - start)
    rate, ceiling = allowed.rate_ft_min[before.kind], allowed.ceiling[before.kind]
    room = np.where(sign > 0.0, rate * np.ceil(np.maximum(ceiling - start, 0.0) / rate), np.inf)
    climbed = np.minimum(np.minimum(rate * _seconds(start.ndim), to_go), room)
    phase = np.where(climbed < to_go, sign, 0.0)[:-1]
    vertical_speed = phase * (climbed[:-1] < room) * rate
    level = start + sign * climbed
    airspeed = _airspeed_kt(level[:-1], phase, before.kind, allowed)
    speed = np.sqrt(airspeed**2 - (vertical_speed * _KT_PER_FT_MIN) ** 2)
    return level[-1], np.where(climbed[-1] < to_go, vertical_speed[-1], 0.0), speed


def _airspeed_kt(
    level_ticks: Values, phase: Values, kind: Int[np.ndarray, "..."], allowed: Limits
) -> Values:
    """True airspeed, interpolated between whole flight levels."""
    fl = level_ticks / TICKS_PER_FL
    below, column = np.floor(fl).astype(int), (1.0 - phase).astype(int)
    low, high = (allowed.airspeed_kt[kind, column, below + step] for step in (0, 1))
    between: Values = low + (fl - below) * (high - low)
    return between


def greatest_turn_deg(before: Rows, after: Rows, speed_kt: Values) -> Values:
    """The largest change of heading in a cycle.

    This is 1.5 degrees per second. On own navigation it may also be that of a fly-by turn with the
    reported radius, or at 30 degrees of bank if a fix was passed within the cycle.
    """
    slowest, fastest = speed_kt.min(axis=0), speed_kt.max(axis=0)
    tightest = np.where(after.next_fix != before.next_fix, least_radius_nm(slowest), np.inf)
    for radius in (before.turn_radius_nm, after.turn_radius_nm):
        tightest = np.minimum(tightest, np.where(radius > 0.0, radius, np.inf))
    fly_by = np.where(before.own_navigation, np.degrees(fastest / 3600.0 / tightest), 0.0)
    return SECONDS * np.maximum(fly_by, TURN_RATE_DEG_S)


def least_radius_nm(speed_kt: Values) -> Values:
    """The radius of a coordinated turn at the largest bank."""
    return (speed_kt / 3600.0) ** 2 / (_G_NM_S2 * np.tan(np.radians(MAX_BANK_DEG)))
