"""Predicted flight: the paths and levels of flights in the next ten minutes.

Flights are predicted at their present ground speed and at nominal rates of climb and descent. Turns
at fixes are those of `skystack.simulator.own_navigation`, in two straight pieces.
"""

from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import bearing, direction, dot, length, value_of, wrap_180
from skystack.airspace.landing import LANDING_NM
from skystack.airspace.sector import Sector
from skystack.compilation.loops import repeated
from skystack.compilation.subroutine import subroutine
from skystack.simulator.own_navigation import (
    EARLIEST_TURN_RADII,
    fix_leg,
    fix_of,
    turn_radius_nm,
)
from skystack.simulator.simulator import TURN_RATE_DEG_S, Simulator
from skystack.simulator.traffic import DIRECT, Traffic

TIMES_S = (*range(0, 120, 15), *range(120, 601, 40))
"""The times at which flights are predicted; motion in between is taken to be straight."""
HORIZON_S = float(TIMES_S[-1])
MAX_HALF_TURN_RAD = float(np.arctan(EARLIEST_TURN_RADII))
"""Half of the sharpest turn that is predicted at a fix. It begins `EARLIEST_TURN_RADII` before the
fix, and no turn in the simulator begins earlier, so sharper turns are predicted like it."""
LEAVES_LATE_S = 12.0
"""A flight counts until the end of the cycle in which it crosses its exit edge, which may be 0.5 NM
beyond the exit fix."""
PASSED_NM = 1.0
"""A flight that is still present this far beyond its exit fix has missed its exit."""
SLOW_TURN_DEG = 15.0
"""Turns to a fix that are smaller are flown with little bank, on a circle that may be so large that
the flight reaches the fix first."""
NEAR_NM = 1.0
"""A slow turn that would end less than this before the next turn begins, or before the fix if there
is none, is predicted as straight flight to the fix."""
LEGS = 6
"""The number of legs of a route that are predicted."""

Rows = Float[Array, "slots *batch"]
Flags = Bool[Array, "slots *batch"]


class PredictedPath(NamedTuple):
    """Predicted positions in the plane, and the time after which the flight is gone."""

    east_nm: Float[Array, "times slots *batch"]
    north_nm: Float[Array, "times slots *batch"]
    until_s: Rows


def predicted_level(
    simulator: Simulator, traffic: Traffic, goal_ticks: Rows
) -> Float[Array, "times slots *batch"]:
    """Levels at the predicted times, on the way to a goal."""
    to_go = goal_ticks - traffic.level_ticks
    rate = simulator.performance.vertical_speed_ft_min(
        traffic.level_ticks, jnp.sign(to_go), traffic.kind
    )
    reach = jnp.abs(rate)[None] * _times(to_go)
    return traffic.level_ticks[None] + jnp.clip(to_go[None], -reach, reach)


def _times(like: Rows) -> Array:
    return jnp.asarray(TIMES_S, dtype=jnp.float32).reshape((-1,) + (1,) * like.ndim)


def _speed(sector: Sector, traffic: Traffic) -> Rows:
    """Plane units per second."""
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    return traffic.ground_speed_kt / 3600.0 * scale


def path_as_cleared(sector: Sector, traffic: Traffic) -> PredictedPath:
    """The path on the cleared heading, or along the route."""
    assert traffic.cleared_fix is not None
    direct, own = traffic.pending_turn == DIRECT, traffic.cleared_along_route
    fix = jnp.where(direct, traffic.cleared_fix, traffic.next_fix)
    along = path_along_route(sector, traffic, fix, ~direct)
    ahead = path_on_heading(sector, traffic, traffic.cleared_heading_deg)
    return PredictedPath(
        jnp.where(own[None], along.east_nm, ahead.east_nm),
        jnp.where(own[None], along.north_nm, ahead.north_nm),
        jnp.where(own, along.until_s, ahead.until_s),
    )


class Turn(NamedTuple):
    """A turn to a heading, the shorter way. Distances are in plane units."""

    turning_s: Rows
    """The time that it takes."""
    sine: Rows
    cosine: Rows
    radius: Rows
    """Positive to the right."""
    speed: Rows
    """Per second."""
    east: Rows
    """The sine of the heading at the start."""
    north: Rows
    """The cosine of the heading at the start."""


def path_on_heading(sector: Sector, traffic: Traffic, heading_deg: Rows) -> PredictedPath:
    """The path after a turn to a heading, the shorter way."""
    turn = subroutine(partial(_turn_to, sector), traffic, heading_deg)
    time = _times(heading_deg)
    # The sine and cosine of the angle turned so far: constants, or those of the whole turn.
    so_far = np.radians(TURN_RATE_DEG_S * np.array(TIMES_S, dtype=np.float32)).reshape(time.shape)
    turning = time < turn.turning_s[None]
    sine = jnp.where(turning, jnp.asarray(np.sin(so_far)), turn.sine[None])
    cosine = jnp.where(turning, jnp.asarray(np.cos(so_far)), turn.cosine[None])
    # Along the heading at the start and to the inside of the turn; then the straight part.
    straight = turn.speed[None] * jnp.maximum(time - turn.turning_s[None], 0.0)
    ahead = jnp.abs(turn.radius)[None] * sine + straight * cosine
    inside = jnp.abs(turn.radius)[None] * (1.0 - cosine) + straight * sine
    right = jnp.where(turn.radius[None] < 0.0, -inside, inside)
    return PredictedPath(
        traffic.position_nm[None, :, 0] + ahead * turn.east[None] + right * turn.north[None],
        traffic.position_nm[None, :, 1] + ahead * turn.north[None] - right * turn.east[None],
        jnp.full_like(heading_deg, jnp.inf),
    )


def _turn_to(sector: Sector, traffic: Traffic, heading_deg: Rows) -> Turn:
    """The turn to a heading. Sine and cosine are those of its angle, whatever its side."""
    speed = _speed(sector, traffic)
    turn = wrap_180(heading_deg - traffic.heading_deg)
    angle, heading = jnp.radians(jnp.abs(turn)), jnp.radians(traffic.heading_deg)
    return Turn(
        turning_s=jnp.abs(turn) / TURN_RATE_DEG_S,
        sine=jnp.sin(angle),
        cosine=jnp.cos(angle),
        radius=jnp.where(turn < 0.0, -speed, speed) / np.radians(TURN_RATE_DEG_S),
        speed=speed,
        east=jnp.sin(heading),
        north=jnp.cos(heading),
    )


class Segments(NamedTuple):
    """A path of straight segments, with an axis for them before that of the flights."""

    east: Float[Array, "segments slots *batch"]
    """Displacements in plane units."""
    north: Float[Array, "segments slots *batch"]
    flown: Float[Array, "segments slots *batch"]
    """The length that is flown in each: that of an arc where the segment is its chord."""
    exit_at: Rows
    """The length flown until the exit fix or the landing; until the last fix if that has been
    missed."""


class _Flying(NamedTuple):
    """A flight on the way along its route. Distances are in plane units."""

    begin: Float[Array, "slots 2 *batch"]
    """Where the leg begins: at the fix before, or at the end of the first turn."""
    lead: Rows
    """The distance from `begin` at which the turn before the leg ends."""
    ahead: Float[Array, "slots 2 *batch"]
    """The direction flown."""
    total: Rows
    """The length flown so far."""
    exit_at: Rows
    """See `Segments`."""


def path_along_route(
    sector: Sector, traffic: Traffic, fix: Int[Array, "slots *batch"], continues: Flags
) -> PredictedPath:
    """The path to a fix of the route and on along it, until the flight leaves at its exit.

    `continues` marks flights that are on own navigation to the fix already, perhaps still turning.
    The others begin a turn to it now.
    """
    path = subroutine(partial(_segments, sector), traffic, fix, continues)
    speed = _speed(sector, traffic)
    start = traffic.position_nm
    left = speed[None] * _times(speed)

    def fly(flying: tuple[Array, ...], number: Any) -> tuple[tuple[Array, ...], None]:
        east, north, left = flying
        flown = path.flown[number][None]
        part = jnp.clip(left / jnp.maximum(flown, 1e-6), 0.0, 1.0)
        east = east + part * path.east[number][None]
        north = north + part * path.north[number][None]
        return (east, north, jnp.maximum(left - flown, 0.0)), None

    begun = (*(jnp.broadcast_to(start[None, :, axis], left.shape) for axis in (0, 1)), left)
    (east, north, _), _ = repeated(fly, begun, path.flown.shape[0])
    until_s = path.exit_at / jnp.maximum(speed, 1e-9) + LEAVES_LATE_S
    return PredictedPath(east, north, until_s)


def _segments(
    sector: Sector, traffic: Traffic, fix: Int[Array, "slots *batch"], continues: Flags
) -> Segments:
    """The turn to the fix, the legs, and the turns in between, each in two chords."""
    table = sector.route_table
    last, exit_fix = (value_of(each, traffic.route) for each in (table.last_fix, table.exit_fix))
    speed = _speed(sector, traffic)
    begin = traffic.position_nm
    pieces, heading = _first_turn(sector, traffic, fix, continues, fix < last)
    for vector, _ in pieces:
        begin = begin + vector
    total = sum((flown for _, flown in pieces), start=jnp.zeros_like(speed))

    def fly(flying: _Flying, number: Any) -> tuple[_Flying, tuple[Array, Array]]:
        """Fly a leg straight, then the turn at its fix in two chords."""
        at = fix_of(table, traffic.route, jnp.minimum(fix + number, last))
        used = fix + number <= last
        leg = at - flying.begin
        distance = jnp.where(used, length(leg), 0.0)
        unit = jnp.where(
            (distance > 1e-3)[:, None], leg / jnp.maximum(distance, 1e-3)[:, None], flying.ahead
        )
        after = fix_leg(table, traffic.route, jnp.minimum(fix + number, last))
        turns = fix + number < last
        points, lead, arc = subroutine(partial(_corner, sector), unit, after, turns, traffic)
        entry, middle, leave = points
        straight = jnp.maximum(distance - flying.lead - lead, 0.0)
        # Beyond the last fix the flight holds its heading.
        endless = fix + number == last
        straight = jnp.where(endless, speed * 2.0 * HORIZON_S, straight)
        exit_at = flying.total + straight + arc / 2.0
        flown = _Flying(
            begin=at,
            lead=lead,
            ahead=jnp.where(turns[:, None], after, unit),
            total=flying.total + straight + arc,
            exit_at=jnp.where(fix + number <= exit_fix, exit_at, flying.exit_at),
        )
        vectors = jnp.stack([straight[:, None] * unit, middle - entry, leave - middle])
        return flown, (vectors, jnp.stack([straight, arc / 2.0, arc / 2.0]))

    begun = _Flying(
        begin, jnp.zeros_like(speed), direction(heading), total, _beyond_exit_fix(sector, traffic)
    )
    flying, (vectors, lengths) = repeated(fly, begun, LEGS)
    exit_at = flying.exit_at
    if table.lands.any():
        landing = LANDING_NM * sector.plane.scale(traffic.position_nm[:, 1])
        exit_at -= jnp.where(value_of(table.lands, traffic.route), landing, 0.0)
    # The legs and the pieces of each become one axis.
    turned = jnp.stack([vector for vector, _ in pieces])
    vectors = jnp.concatenate([turned, vectors.reshape(-1, *turned.shape[1:])])
    first = jnp.stack([flown for _, flown in pieces])
    flown = jnp.concatenate([first, lengths.reshape(-1, *first.shape[1:])])
    return Segments(vectors[:, :, 0], vectors[:, :, 1], flown, exit_at)


def _beyond_exit_fix(sector: Sector, traffic: Traffic) -> Rows:
    """The length left to fly for a flight whose next fix is after its exit fix.

    It leaves abeam its exit fix, which may still be ahead because a turn begins before its fix. If
    it has missed its exit, it flies to the last fix.
    """
    table, route = sector.route_table, traffic.route
    last, exit_index = value_of(table.last_fix, route), value_of(table.exit_fix, route)
    exit_fix, last_fix = fix_of(table, route, exit_index), fix_of(table, route, last)
    to_exit = dot(exit_fix - traffic.position_nm, fix_leg(table, route, exit_index))
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    missed = to_exit < -PASSED_NM * scale
    to_last = length(last_fix - traffic.position_nm)
    return jnp.where(missed, to_last, jnp.maximum(to_exit, 0.0))


Piece = tuple[Float[Array, "slots 2 *batch"], Rows]
"""A displacement, and the length that is flown."""


def _first_turn(
    sector: Sector,
    traffic: Traffic,
    fix: Int[Array, "slots *batch"],
    continues: Flags,
    turns: Flags,
) -> tuple[list[Piece], Rows]:
    """The turn to a fix in two chords, and the heading after it.

    `turns` marks flights that turn again at the fix. A slow turn that would last until then, or
    almost, is predicted as straight flight to the fix.
    """
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    to_fix = fix_of(sector.route_table, traffic.route, fix) - traffic.position_nm
    to_course = turn = wrap_180(bearing(to_fix) - traffic.heading_deg)
    radius = turn_radius_nm(jnp.abs(turn), traffic.ground_speed_kt)
    radius = jnp.where(continues & (traffic.turn_radius_nm > 0.0), traffic.turn_radius_nm, radius)
    # On the way to the fix there is no turn.
    radius = jnp.where(continues & (traffic.turn_radius_nm == 0.0), 0.0, radius * scale)

    def turned(angle_deg: Rows) -> Float[Array, "slots 2 *batch"]:
        half = traffic.heading_deg + angle_deg / 2.0
        chord = 2.0 * radius * jnp.abs(jnp.sin(jnp.radians(angle_deg / 2.0)))
        return chord[:, None] * direction(half)

    slow = jnp.abs(turn) < SLOW_TURN_DEG
    turn = _turn_to_point(to_fix, traffic.heading_deg, radius, turn)
    course = to_fix / jnp.maximum(length(to_fix), 1e-6)[:, None]
    after = fix_leg(sector.route_table, traffic.route, fix)
    _, lead, _ = _corner(sector, course, after, turns, traffic)
    slow &= length(to_fix - turned(turn)) < lead + scale * NEAR_NM
    radius, turn = jnp.where(slow, 0.0, radius), jnp.where(slow, to_course, turn)
    middle = turned(turn / 2.0)
    arc = radius * jnp.radians(jnp.abs(turn))
    halves: list[Piece] = [(middle, arc / 2.0), (turned(turn) - middle, arc / 2.0)]
    return halves, traffic.heading_deg + turn


def _turn_to_point(
    to_fix: Float[Array, "slots 2 *batch"], heading_deg: Rows, radius: Rows, turn_deg: Rows
) -> Rows:
    """The turn after which a fix is straight ahead, in the direction of `turn_deg`.

    The line from the end of the turn to the fix is tangent to the circle flown. If the fix is
    inside the circle, the turn ends at the point of the circle nearest to the fix.
    """
    right = jnp.where(turn_deg < 0.0, -1.0, 1.0)
    ahead = dot(to_fix, direction(heading_deg))
    aside = dot(to_fix, direction(heading_deg + 90.0)) * right
    # The angle at the centre of the circle from the flight to the fix.
    from_centre = jnp.arctan2(ahead, radius - aside)
    tangent = jnp.sqrt(jnp.maximum(ahead**2 + (radius - aside) ** 2 - radius**2, 0.0))
    turn = jnp.degrees(from_centre - jnp.arctan2(tangent, radius)) % 360.0
    # Rounding could otherwise add a full circle for a flight that already heads for its fix.
    return jnp.where(turn > 359.0, turn - 360.0, turn) * right


def _corner(
    sector: Sector,
    unit: Float[Array, "slots 2 *batch"],
    after: Float[Array, "slots 2 *batch"],
    turns: Flags,
    traffic: Traffic,
) -> tuple[list[Float[Array, "slots 2 *batch"]], Rows, Rows]:
    """A turn at a fix: where it begins, its middle and where it ends, relative to the fix.

    Also the distance from the fix at which it begins, and the length of the arc.
    """
    angle = jnp.where(turns, jnp.arccos(jnp.clip(dot(unit, after), -1.0, 1.0)), 0.0)
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    radius = turn_radius_nm(jnp.degrees(angle), traffic.ground_speed_kt) * scale
    half = jnp.minimum(angle / 2.0, MAX_HALF_TURN_RAD)
    lead = radius * jnp.tan(half)
    inwards = after - unit
    inwards = inwards / jnp.maximum(length(inwards), 1e-6)[:, None]
    inside = radius * (1.0 / jnp.cos(half) - 1.0)
    points = [-lead[:, None] * unit, inside[:, None] * inwards, lead[:, None] * after]
    points = [jnp.where(turns[:, None], point, 0.0) for point in points]
    return points, jnp.where(turns, lead, 0.0), radius * angle
