"""The invariants of every flown cycle: each is a quantity that must not exceed its bound.

The quantities are computed in float64 from the flight, independently of the simulator's code.
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
"""By the name of the invariant: the deviation from it, and where it applies."""


class Tolerance(NamedTuple):
    most: float
    unit: str = "values"


EXACT = Tolerance(0.0)
BOUNDS = {
    "instruct changes nothing physical": EXACT,
    "instruct changes only what is cleared": EXACT,
    "an inactive aircraft does not change": EXACT,
    "all values are finite, headings in [0, 360)": EXACT,
    "moves at most speed x time": Tolerance(2e-4, "NM"),
    "moves at least as its turn allows": Tolerance(2e-4, "NM"),
    "turns no faster than the turn rate": Tolerance(2e-4, "deg"),
    "fly-by turns at 30 degrees of bank at most": Tolerance(0.001, "deg"),
    "no level beyond the one flown to": Tolerance(0.0, "ticks"),
    "the level, to the tick": Tolerance(0.0, "ticks"),
    "the vertical speed": Tolerance(0.0, "ft/min"),
    "the ground speed": Tolerance(0.001, "kt"),
    "the heading": Tolerance(2e-4, "deg"),
    "a heading is captured exactly": EXACT,
    "the displacement": Tolerance(2e-4, "NM"),
    "a clearance is flown from the next cycle on": EXACT,
    "a turn begins the way that was cleared": Tolerance(1e-4, "deg"),
}
"""The bounds for one cycle. From "the level" on, the closed form of the cycle is the reference."""

CLEARED = ("cleared_heading_deg", "cleared_level_ticks", "pending_turn", "cleared_fix")
"""The only fields that `instruct` may change."""
PHYSICAL = tuple(name for name in Traffic._fields if name not in CLEARED)


def changed(a: Rows, b: Rows, fields: tuple[str, ...] = Traffic._fields) -> Values:
    """The number of fields of each aircraft that differ in any bit except the sign of zero."""
    total = np.zeros(a.level_ticks.shape)
    for name in fields:
        if getattr(a, name) is None:  # an optional field
            continue
        differs = getattr(a, name) != getattr(b, name)
        total += differs.any(axis=2) if name == "position_nm" else differs
    return total


def angle_deg(a: Values, b: Values) -> Values:
    """The angle from b to a the shorter way, -180 to 180."""
    return (a - b + 180.0) % 360.0 - 180.0


def invariants(
    flown: FlownWorld, clearances: Rows, allowed: Limits, plane: MercatorPlane
) -> Quantities:
    """All invariants of a single flight."""
    now = expected(flown.instructed, allowed)
    lat_lon = _lat_lon(plane, flown.instructed), _lat_lon(plane, flown.after)
    return {
        **_of_instruct(flown, clearances),
        **_of_limits(flown, now, _distance_nm(*lat_lon)),
        **_of_closed_forms(flown, now, _missed_nm(*lat_lon, now)),
        **_of_adoption(flown),
    }


def _of_instruct(flown: FlownWorld, clearances: Rows) -> Quantities:
    before, instructed, after = flown
    everywhere = np.ones_like(before.active)
    turns = before.active & (clearances.turn != NO_TURN)
    levels = before.active & clearances.changes_level
    intended = before._replace(
        cleared_heading_deg=np.where(turns, clearances.heading_deg, before.cleared_heading_deg),
        pending_turn=np.where(turns, clearances.turn, before.pending_turn),
        cleared_level_ticks=np.where(levels, clearances.level_ticks, before.cleared_level_ticks),
    )
    return {
        "instruct changes nothing physical": (changed(before, instructed, PHYSICAL), everywhere),
        "instruct changes only what is cleared": (
            changed(intended, instructed, CLEARED),
            everywhere,
        ),
        "an inactive aircraft does not change": (changed(before, after), ~before.active),
    }


def _of_limits(flown: FlownWorld, now: Expected, moved_nm: Values) -> Quantities:
    """The limits of every aircraft, also on own navigation."""
    _, instructed, after = flown
    active, heading = instructed.active, after.heading_deg.astype(float)
    leaves = [leaf for leaf in after if leaf is not None]  # some fields are optional
    floats = [leaf for leaf in leaves if leaf.dtype.kind == "f" and leaf.ndim == active.ndim]
    wrong = np.sum(
        [~np.isfinite(leaf) for leaf in (*floats, after.position_nm.sum(axis=2))], axis=0
    )
    path = now.speed_kt.sum(axis=0) / 3600.0
    most = greatest_turn_deg(instructed, after, now.speed_kt)
    # All headings of a cycle are within an angle of `most`, so project on the middle of that angle.
    least = path * np.cos(np.radians(np.minimum(most, 180.0) / 2.0))
    start = instructed.level_ticks.astype(float)
    target = instructed.flown_level_ticks.astype(float)
    beyond = np.abs(after.level_ticks - (start + target) / 2.0) - np.abs(target - start) / 2.0
    passed = active & (after.next_fix != instructed.next_fix) & (after.turn_radius_nm > 0.0)
    tight = least_radius_nm(now.speed_kt.min(axis=0)) / np.where(passed, after.turn_radius_nm, 1.0)
    bank = np.degrees(np.arctan(tight * np.tan(np.radians(30.0))))
    return {
        "all values are finite, headings in [0, 360)": (
            wrong + (heading < 0.0) + (heading >= 360.0),
            active,
        ),
        "moves at most speed x time": (moved_nm - path, active),
        "moves at least as its turn allows": (least - moved_nm, active),
        "turns no faster than the turn rate": (
            np.abs(angle_deg(heading, instructed.heading_deg)) - most,
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
    """The distance of an aircraft from the end of six geodesics, one for each second."""
    lat, lon = before
    for along_deg, speed_kt in zip(now.along_deg, now.speed_kt, strict=True):
        lon, lat, _ = WGS84.fwd(lon, lat, along_deg, speed_kt / 3600.0 * METRES_PER_NM)
    return _distance_nm(np.stack([lat, lon]), after)


def _of_closed_forms(flown: FlownWorld, now: Expected, missed_nm: Values) -> Quantities:
    _, instructed, after = flown
    active, steered = instructed.active, instructed.active & ~instructed.own_navigation
    off = np.abs(angle_deg(after.heading_deg.astype(float), now.heading_deg))
    arrives = steered & (np.abs(instructed.turn_deg) < 9.0 - 1e-4)
    missed = (after.heading_deg != instructed.flown_heading_deg).astype(float)
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
    _, instructed, after = flown
    pending = instructed.pending_turn
    new = instructed.active & (pending != NO_TURN)
    heading = np.where(new, instructed.cleared_heading_deg, after.flown_heading_deg)
    intended = after._replace(
        flown_level_ticks=instructed.cleared_level_ticks,
        flown_heading_deg=heading,
        cleared_heading_deg=np.where(new, heading, after.cleared_heading_deg),
        own_navigation=after.own_navigation & ~new,
        pending_turn=np.zeros_like(pending),
    )
    right = (heading.astype(float) - after.heading_deg) % 360.0
    left = -((after.heading_deg - heading.astype(float)) % 360.0)
    shorter = np.where(right <= 180.0, right, left)
    turn = np.select([pending == LEFT, pending == RIGHT], [left, right], shorter)
    off = np.abs(after.turn_deg - turn)
    # A half turn has the same length in both directions.
    half = (turn == shorter) & (np.abs(np.abs(shorter) - 180.0) < 1e-4)
    off = np.where(half, np.abs(np.abs(after.turn_deg) - 180.0), off)
    return {
        "a clearance is flown from the next cycle on": (
            changed(intended, after),
            instructed.active,
        ),
        "a turn begins the way that was cleared": (off, new),
    }
