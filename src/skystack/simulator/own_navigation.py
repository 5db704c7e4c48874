"""Own navigation: aircraft follow their routes with fly-by turns, as in BluebirdDT."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import (
    bearing,
    direction,
    dot,
    length,
    point_of,
    value_of,
    wrap_180,
    wrap_360,
)
from skystack.airspace.sector import RouteTable, Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import NO_TURN, RADIUS_UNKNOWN, Traffic

BANK_PER_TURN = 0.4
"""Degrees of bank per degree of turn, within the limits below."""
MIN_BANK_DEG, MAX_BANK_DEG = 2.0, 30.0
ON_TRACK_DEG = 0.01
"""A turn is complete when the heading is this close to the bearing of the fix."""
EARLIEST_TURN_RADII = 3.0
"""A turn starts at most this many turn radii before the fix, even if it is sharp."""
_G_NM_S2 = 9.80665 / 1852.0


def steer(
    traffic: Traffic,
    sector: Sector,
    turn_rate_deg_s: Float[Array, "aircraft *batch"],
    route_end_nm: float,
    route_turn_deg_s: float | None = None,
) -> tuple[Traffic, Float[Array, "aircraft *batch"]]:
    """Steer the aircraft on own navigation towards their next fix for the next second.

    They fly the geodesic to it. Returns the traffic with its turns updated, and each aircraft's
    turn rate [deg/s]: the rate of the arc during a fly-by turn, otherwise `turn_rate_deg_s`.
    `route_turn_deg_s` is the rate of turns to fixes; None for coordinated turns.
    """
    inbound = _to_next_fix(sector, traffic)
    if traffic.cleared_fix is not None:
        traffic = _begin_direct(traffic, bearing(inbound), route_turn_deg_s)
    traffic = _sequence(traffic, sector, inbound, route_end_nm, route_turn_deg_s)
    own = traffic.own_navigation
    course = wrap_360(bearing(_to_next_fix(sector, traffic)))
    turn = wrap_180(course - traffic.heading_deg)
    on_track = own & (jnp.abs(turn) < ON_TRACK_DEG)
    radius = jnp.where(on_track, 0.0, traffic.turn_radius_nm)
    fly_by = own & (radius > 0.0)
    arc = jnp.degrees(traffic.ground_speed_kt / 3600.0 / jnp.where(fly_by, radius, 1.0))
    traffic = traffic._replace(
        heading_deg=jnp.where(on_track, course, traffic.heading_deg),
        flown_heading_deg=jnp.where(own, course, traffic.flown_heading_deg),
        turn_deg=jnp.where(own, jnp.where(on_track, 0.0, turn), traffic.turn_deg),
        turn_radius_nm=radius,
    )
    return traffic, jnp.where(fly_by, arc, turn_rate_deg_s)


def _begin_direct(
    traffic: Traffic, course_deg: Float[Array, "aircraft *batch"], rate_deg_s: float | None
) -> Traffic:
    """Begin the turns to the fixes that aircraft have just been cleared direct to.

    `course_deg` is that to the next fix.

    If an aircraft has flown past the last fix, its own navigation ends at once, but it still makes
    the turn, as in BluebirdDT.
    """
    begins = traffic.own_navigation & (traffic.turn_radius_nm == RADIUS_UNKNOWN)
    turn = wrap_180(course_deg - traffic.heading_deg)
    radius = turn_radius_nm(jnp.abs(turn), traffic.ground_speed_kt, rate_deg_s)
    return traffic._replace(
        flown_heading_deg=jnp.where(begins, wrap_360(course_deg), traffic.flown_heading_deg),
        turn_deg=jnp.where(begins, turn, traffic.turn_deg),
        turn_radius_nm=jnp.where(begins, radius, traffic.turn_radius_nm),
    )


def _sequence(
    traffic: Traffic,
    sector: Sector,
    inbound: Float[Array, "aircraft 2 *batch"],
    route_end_nm: float,
    rate_deg_s: float | None,
) -> Traffic:
    """Start the turn to the next leg when it is due, and end own navigation at the last fix.

    `inbound` is the direction to the next fix.
    """
    own, routes = traffic.own_navigation, sector.route_table
    last = value_of(routes.last_fix, traffic.route)
    target = fix_of(routes, traffic.route, traffic.next_fix)
    outbound = fix_leg(routes, traffic.route, traffic.next_fix)
    scale = sector.plane.scale((traffic.position_nm[:, 1] + target[:, 1]) / 2.0)
    offset = (target - traffic.position_nm) / scale[:, None]
    distance = length(offset)
    at_last = traffic.next_fix >= last

    turn = jnp.abs(wrap_180(bearing(outbound) - bearing(inbound)))
    radius = turn_radius_nm(turn, traffic.ground_speed_kt, rate_deg_s)
    lead = jnp.minimum(
        radius * jnp.tan(jnp.radians(jnp.minimum(turn, 179.0)) / 2.0), EARLIEST_TURN_RADII * radius
    )
    turns = own & ~at_last & (distance <= lead)
    ended = own & at_last & ((distance <= route_end_nm) | _flown_past(traffic, inbound, distance))
    return traffic._replace(
        next_fix=jnp.where(turns, traffic.next_fix + 1, traffic.next_fix),
        turn_radius_nm=jnp.where(turns, radius, traffic.turn_radius_nm),
        own_navigation=own & ~ended,
        cleared_heading_deg=jnp.where(
            ended & (traffic.pending_turn == NO_TURN),
            traffic.flown_heading_deg,
            traffic.cleared_heading_deg,
        ),
    )


def _to_next_fix(sector: Sector, traffic: Traffic) -> Float[Array, "aircraft 2 *batch"]:
    """The initial direction of the geodesic to the next fix.

    This is a subroutine; otherwise XLA would compute it again for each use of each component.
    """
    target = fix_of(sector.route_table, traffic.route, traffic.next_fix)
    return subroutine(sector.plane.geodesic_direction, traffic.position_nm, target)


def fix_of(
    routes: RouteTable, route: Int[Array, "aircraft *batch"], fix: Int[Array, "aircraft *batch"]
) -> Float[Array, "aircraft 2 *batch"]:
    """The position of a fix of each aircraft's route, by its index in the route."""
    longest = routes.fixes_nm.shape[1]
    return point_of(routes.fixes_nm.reshape(-1, 2), route * longest + fix)


def fix_leg(
    routes: RouteTable, route: Int[Array, "aircraft *batch"], fix: Int[Array, "aircraft *batch"]
) -> Float[Array, "aircraft 2 *batch"]:
    """The direction of the geodesic leg that starts at a fix of each aircraft's route."""
    longest = routes.fixes_nm.shape[1]
    return point_of(routes.leg_direction.reshape(-1, 2), route * longest + fix)


def turn_radius_nm(
    turn_deg: Float[Array, "aircraft *batch"],
    ground_speed_kt: Float[Array, "aircraft *batch"],
    rate_deg_s: float | None = None,
) -> Float[Array, "aircraft *batch"]:
    """The radius of a turn at a given rate or, without one, of a coordinated turn.

    The bank angle of a coordinated turn depends on the size of the turn.
    """
    if rate_deg_s is not None:
        return ground_speed_kt / 3600.0 / np.radians(rate_deg_s)
    bank = jnp.clip(BANK_PER_TURN * turn_deg, MIN_BANK_DEG, MAX_BANK_DEG)
    speed_nm_s = ground_speed_kt / 3600.0
    return speed_nm_s**2 / (_G_NM_S2 * jnp.tan(jnp.radians(bank)))


def _flown_past(
    traffic: Traffic,
    inbound: Float[Array, "aircraft 2 *batch"],
    distance_nm: Float[Array, "aircraft *batch"],
) -> Bool[Array, "aircraft *batch"]:
    """Whether the last fix is behind and inside the current turn, so that it cannot be reached.

    `inbound` is the initial direction of the geodesic to the fix. Far from the fix, that of the
    straight line in the plane may differ by degrees.
    """
    ahead = distance_nm * dot(inbound, direction(traffic.heading_deg)) / length(inbound)
    lateral = jnp.sqrt(jnp.maximum(distance_nm**2 - ahead**2, 0.0))
    behind = (traffic.turn_radius_nm > 0.0) & (ahead < 0.0)
    return behind & (lateral <= 2.0 * traffic.turn_radius_nm)
