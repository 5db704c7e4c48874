"""What must hold of every cycle that is flown: each a quantity that may not pass its bound.

The quantities are computed in float64 from what was flown, beside the simulator's own code.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from skystack.airspace.projection import METRES_PER_NM, WGS84, MercatorPlane
from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, Traffic
from verification.simulator.closed_form import (
    Expected,
    Limits,
    Rows,
    expected,
    greatest_turn_deg,
    least_radius_nm,
)
from verification.simulator.random_worlds import FlownWorld

Values = Float[np.ndarray, "cycles aircraft worlds"]
Degrees = Float[np.ndarray, "2 cycles aircraft worlds"]
"""Latitudes and longitudes."""
Where = Bool[np.ndarray, "cycles aircraft worlds"]
Quantities = dict[str, tuple[Values, Where]]
"""By the name of the invariant: how far from what it says, and where it says anything."""


class Tolerance(NamedTuple):
    most: float
    unit: str = "values"


EXACT = Tolerance(0.0)
BOUNDS = {
    "instruct changes nothing physical": EXACT,
    "instruct clears what was said, no more": EXACT,
    "an inactive aircraft changes in nothing": EXACT,
    "everything is finite, headings in [0, 360)": EXACT,
    "moves no further than speed x time": Tolerance(2e-4, "NM"),
    "moves no less than a turn allows": Tolerance(2e-4, "NM"),
    "turns no faster than the turn rate": Tolerance(2e-4, "deg"),
    "fly-by turns at 30 degrees of bank at most": Tolerance(0.001, "deg"),
    "no level beyond the one flown to": Tolerance(0.0, "ticks"),
    "the level, to the tick": Tolerance(0.0, "ticks"),
    "the vertical speed": Tolerance(0.0, "ft/min"),
    "the ground speed": Tolerance(0.001, "kt"),
    "the heading": Tolerance(2e-4, "deg"),
    "a heading is captured exactly": EXACT,
    "the displacement": Tolerance(2e-4, "NM"),
    "what was told is flown from the next cycle on": EXACT,
    "a turn begins the way that was told": Tolerance(1e-4, "deg"),
}
"""Of one cycle. From "the level" on: against the closed form of the cycle."""

CLEARED = ("cleared_heading_deg", "cleared_level_ticks", "pending_turn")
"""The only fields that `instruct` may change."""
PHYSICAL = tuple(name for name in Traffic._fields if name not in CLEARED)


def changed(a: Rows, b: Rows, fields: tuple[str, ...] = Traffic._fields) -> Values:
    """How many fields of each aircraft differ, bit for bit but for the sign of zero."""
    total = np.zeros(a.level_ticks.shape)
    for name in fields:
        differs = getattr(a, name) != getattr(b, name)
        total += differs.any(axis=2) if name == "position_nm" else differs
    return total


def angle_deg(a: Values, b: Values) -> Values:
    """From b to a the shorter way, -180 to 180."""
    return (a - b + 180.0) % 360.0 - 180.0


def invariants(flown: FlownWorld, said: Rows, allowed: Limits, plane: MercatorPlane) -> Quantities:
    """All that is looked at in a flight by itself."""
    now = expected(flown.told, allowed)
    lat_lon = _lat_lon(plane, flown.told), _lat_lon(plane, flown.after)
    return {
        **_of_instruct(flown, said),
        **_of_limits(flown, now, _distance_nm(*lat_lon)),
        **_of_closed_forms(flown, now, _missed_nm(*lat_lon, now)),
        **_of_adoption(flown),
    }


def _of_instruct(flown: FlownWorld, said: Rows) -> Quantities:
    before, told, after = flown
    everywhere = np.ones_like(before.active)
    turned = before.active & (said.turn != NO_TURN)
    levelled = before.active & said.changes_level
    meant = before._replace(
        cleared_heading_deg=np.where(turned, said.heading_deg, before.cleared_heading_deg),
        pending_turn=np.where(turned, said.turn, before.pending_turn),
        cleared_level_ticks=np.where(levelled, said.level_ticks, before.cleared_level_ticks),
    )
    return {
        "instruct changes nothing physical": (changed(before, told, PHYSICAL), everywhere),
        "instruct clears what was said, no more": (changed(meant, told, CLEARED), everywhere),
        "an inactive aircraft changes in nothing": (changed(before, after), ~before.active),
    }


def _of_limits(flown: FlownWorld, now: Expected, moved_nm: Values) -> Quantities:
    """Of every aircraft, on own navigation too."""
    _, told, after = flown
    active, heading = told.active, after.heading_deg.astype(float)
    floats = [leaf for leaf in after if leaf.dtype.kind == "f" and leaf.ndim == active.ndim]
    wrong = np.sum(
        [~np.isfinite(leaf) for leaf in (*floats, after.position_nm.sum(axis=2))], axis=0
    )
    path = now.speed_kt.sum(axis=0) / 3600.0
    most = greatest_turn_deg(told, after, now.speed_kt)
    # All headings of a cycle lie within an angle of `most`: seen along its middle.
    least = path * np.cos(np.radians(np.minimum(most, 180.0) / 2.0))
    begun, target = told.level_ticks.astype(float), told.flown_level_ticks.astype(float)
    beyond = np.abs(after.level_ticks - (begun + target) / 2.0) - np.abs(target - begun) / 2.0
    passed = active & (after.next_fix != told.next_fix) & (after.turn_radius_nm > 0.0)
    tight = least_radius_nm(now.speed_kt.min(axis=0)) / np.where(passed, after.turn_radius_nm, 1.0)
    bank = np.degrees(np.arctan(tight * np.tan(np.radians(30.0))))
    return {
        "everything is finite, headings in [0, 360)": (
            wrong + (heading < 0.0) + (heading >= 360.0),
            active,
        ),
        "moves no further than speed x time": (moved_nm - path, active),
        "moves no less than a turn allows": (least - moved_nm, active),
        "turns no faster than the turn rate": (
            np.abs(angle_deg(heading, told.heading_deg)) - most,
            active,
        ),
        "fly-by turns at 30 degrees of bank at most": (bank - 30.0, passed),
        "no level beyond the one flown to": (np.maximum(beyond, 0.0), active),
    }


def _lat_lon(plane: MercatorPlane, traffic: Rows) -> Degrees:
    return np.moveaxis(plane.to_degrees(np.moveaxis(traffic.position_nm, 2, -1)), -1, 0)


def _distance_nm(a: Degrees, b: Degrees) -> Values:
    """Geodesic distances."""
    metres: Values = WGS84.inv(a[1], a[0], b[1], b[0])[2]
    return metres / METRES_PER_NM


def _missed_nm(before: Degrees, after: Degrees, now: Expected) -> Values:
    """How far an aircraft is from where six geodesics of a second each lead."""
    lat, lon = before
    for along_deg, speed_kt in zip(now.along_deg, now.speed_kt, strict=True):
        lon, lat, _ = WGS84.fwd(lon, lat, along_deg, speed_kt / 3600.0 * METRES_PER_NM)
    return _distance_nm(np.stack([lat, lon]), after)


def _of_closed_forms(flown: FlownWorld, now: Expected, missed_nm: Values) -> Quantities:
    _, told, after = flown
    active, steered = told.active, told.active & ~told.own_navigation
    off = np.abs(angle_deg(after.heading_deg.astype(float), now.heading_deg))
    arrives = steered & (np.abs(told.turn_deg) < 9.0 - 1e-4)
    missed = (after.heading_deg != told.flown_heading_deg).astype(float)
    climb_off = np.abs(after.vertical_speed_ft_min - now.vertical_speed_ft_min)
    return {
        "the level, to the tick": (np.abs(after.level_ticks - now.level_ticks), active),
        "the vertical speed": (climb_off, active),
        "the ground speed": (np.abs(after.ground_speed_kt - now.speed_kt[-1]), active),
        "the heading": (off, steered),
        "a heading is captured exactly": (missed, arrives),
        "the displacement": (missed_nm, steered),
    }


def _of_adoption(flown: FlownWorld) -> Quantities:
    _, told, after = flown
    new = told.active & (told.pending_turn != NO_TURN)
    heading = np.where(new, told.cleared_heading_deg, after.flown_heading_deg)
    meant = after._replace(
        flown_level_ticks=told.cleared_level_ticks,
        flown_heading_deg=heading,
        cleared_heading_deg=np.where(new, heading, after.cleared_heading_deg),
        own_navigation=after.own_navigation & ~new,
        pending_turn=np.zeros_like(told.pending_turn),
    )
    right = (heading.astype(float) - after.heading_deg) % 360.0
    left = -((after.heading_deg - heading.astype(float)) % 360.0)
    shorter = np.where(right <= 180.0, right, left)
    way = np.select([told.pending_turn == LEFT, told.pending_turn == RIGHT], [left, right], shorter)
    off = np.abs(after.turn_deg - way)
    # Half a turn is as short either way.
    half = (way == shorter) & (np.abs(np.abs(shorter) - 180.0) < 1e-4)
    off = np.where(half, np.abs(np.abs(after.turn_deg) - 180.0), off)
    return {
        "what was told is flown from the next cycle on": (changed(meant, after), told.active),
        "a turn begins the way that was told": (off, new),
    }
