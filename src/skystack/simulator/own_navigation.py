"""Own navigation: an aircraft follows its route with fly-by turns, as BluebirdDT's do."""

import jax.numpy as jnp
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
from skystack.simulator.traffic import NO_TURN, Traffic

BANK_PER_TURN = 0.4
"""Degrees of bank per degree of turn, within the limits below."""
MIN_BANK_DEG, MAX_BANK_DEG = 2.0, 30.0
ON_TRACK_DEG = 0.01
"""Nearer to the bearing of the fix than this, a turn is over."""
EARLIEST_TURN_RADII = 3.0
"""A turn starts no earlier than this many radii before the fix, however sharp it is."""
_G_NM_S2 = 9.80665 / 1852.0


def steer(
    traffic: Traffic,
    sector: Sector,
    turn_rate_deg_s: Float[Array, "aircraft *batch"],
    route_end_nm: float,
) -> tuple[Traffic, Float[Array, "aircraft *batch"]]:
    """Point the aircraft on own navigation at their next fix for the coming second.

    They fly the geodesic to it. Returns the traffic with its turn to fly, and the rate [deg/s] at
    which each aircraft turns: `turn_rate_deg_s` unless a fly-by turn of a given radius is under
    way.
    """
    traffic = _sequence(traffic, sector, route_end_nm)
    own = traffic.own_navigation
    target = fix_of(sector.route_table, traffic.route, traffic.next_fix)
    wanted = wrap_360(bearing(sector.plane.geodesic_direction(traffic.position_nm, target)))
    turn = wrap_180(wanted - traffic.heading_deg)
    on_track = own & (jnp.abs(turn) < ON_TRACK_DEG)
    radius = jnp.where(on_track, 0.0, traffic.turn_radius_nm)
    fly_by = own & (radius > 0.0)
    arc = jnp.degrees(traffic.ground_speed_kt / 3600.0 / jnp.where(fly_by, radius, 1.0))
    traffic = traffic._replace(
        heading_deg=jnp.where(on_track, wanted, traffic.heading_deg),
        flown_heading_deg=jnp.where(own, wanted, traffic.flown_heading_deg),
        turn_deg=jnp.where(own, jnp.where(on_track, 0.0, turn), traffic.turn_deg),
        turn_radius_nm=radius,
    )
    return traffic, jnp.where(fly_by, arc, turn_rate_deg_s)


def _sequence(traffic: Traffic, sector: Sector, route_end_nm: float) -> Traffic:
    """Turn to the following fix where it is time to, and leave the route at its last fix."""
    own, routes = traffic.own_navigation, sector.route_table
    last = value_of(routes.last_fix, traffic.route)
    target = fix_of(routes, traffic.route, traffic.next_fix)
    following = fix_leg(routes, traffic.route, traffic.next_fix)
    scale = sector.plane.scale((traffic.position_nm[:, 1] + target[:, 1]) / 2.0)
    offset = (target - traffic.position_nm) / scale[:, None]
    distance = length(offset)
    at_last = traffic.next_fix >= last

    here = sector.plane.geodesic_direction(traffic.position_nm, target)
    turn = jnp.abs(wrap_180(bearing(following) - bearing(here)))
    radius = _radius_nm(turn, traffic.ground_speed_kt)
    lead = jnp.minimum(
        radius * jnp.tan(jnp.radians(jnp.minimum(turn, 179.0)) / 2.0), EARLIEST_TURN_RADII * radius
    )
    turns = own & ~at_last & (distance <= lead)
    ended = own & at_last & ((distance <= route_end_nm) | _flown_past(traffic, offset, distance))
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


def fix_of(
    routes: RouteTable, route: Int[Array, "aircraft *batch"], fix: Int[Array, "aircraft *batch"]
) -> Float[Array, "aircraft 2 *batch"]:
    """A fix of each aircraft's route, by its number in the route."""
    longest = routes.fixes_nm.shape[1]
    return point_of(routes.fixes_nm.reshape(-1, 2), route * longest + fix)


def fix_leg(
    routes: RouteTable, route: Int[Array, "aircraft *batch"], fix: Int[Array, "aircraft *batch"]
) -> Float[Array, "aircraft 2 *batch"]:
    """Direction of the geodesic leg that begins at a fix of each aircraft's route."""
    longest = routes.fixes_nm.shape[1]
    return point_of(routes.leg_direction.reshape(-1, 2), route * longest + fix)


def _radius_nm(
    turn_deg: Float[Array, "aircraft *batch"], ground_speed_kt: Float[Array, "aircraft *batch"]
) -> Float[Array, "aircraft *batch"]:
    """Radius of a coordinated turn at the bank that its size calls for."""
    bank = jnp.clip(BANK_PER_TURN * turn_deg, MIN_BANK_DEG, MAX_BANK_DEG)
    speed_nm_s = ground_speed_kt / 3600.0
    return speed_nm_s**2 / (_G_NM_S2 * jnp.tan(jnp.radians(bank)))


def _flown_past(
    traffic: Traffic,
    offset_nm: Float[Array, "aircraft 2 *batch"],
    distance_nm: Float[Array, "aircraft *batch"],
) -> Bool[Array, "aircraft *batch"]:
    """The last fix lies behind, too close to the side to be reached by the turn under way."""
    ahead = dot(offset_nm, direction(traffic.heading_deg))
    aside = jnp.sqrt(jnp.maximum(distance_nm**2 - ahead**2, 0.0))
    return (traffic.turn_radius_nm > 0.0) & (ahead < 0.0) & (aside <= 2.0 * traffic.turn_radius_nm)
