"""Distances from the centreline of the route."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from skystack.airspace.geometry import distance_right_of_route, points_of, value_of
from skystack.airspace.sector import STRAIGHT_WITHIN_NM, Sector
from skystack.simulator.own_navigation import fix_of
from skystack.simulator.traffic import Traffic


def distance_from_route(sector: Sector, traffic: Traffic) -> Float[Array, "aircraft *batch"]:
    """Distance [NM] to the right of the nearest point of the route, with geodesic legs."""
    table = sector.route_table
    fixes = points_of(table.fixes_nm, traffic.route)
    bulges = [value_of(leg, traffic.route) for leg in table.leg_bulge_nm.T]
    if float(np.max(np.abs(table.leg_bulge_nm))) < STRAIGHT_WITHIN_NM:
        bulges = []  # negligible, so not computed
    right = distance_right_of_route(traffic.position_nm, fixes, bulges)
    return right / sector.plane.scale(traffic.position_nm[:, 1])


def distance_from_leg(
    sector: Sector, traffic: Traffic, next_fix: Int[Array, "aircraft *batch"]
) -> Float[Array, "aircraft *batch"]:
    """Distance [NM] to the right of the leg to the next fix; the leg is straight in the plane."""
    table = sector.route_table
    ends = [fix_of(table, traffic.route, jnp.maximum(next_fix + i, 0)) for i in (-1, 0)]
    right = distance_right_of_route(traffic.position_nm, ends)
    return right / sector.plane.scale(traffic.position_nm[:, 1])
