"""The features of each aircraft that a policy can observe, each scaled to [0, 1].

A task lists features by name. The paper's are `("theta_f", "theta_sf", "d_c", "delta_t")` and, for
vertical control, `("d_xfl", "fl_sx", "fl_nx", "delta_t_10")`; skystack adds the others. Angles are
turns to the right in degrees.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from skystack.airspace.geometry import (
    bearing,
    direction,
    edges,
    length,
    point_of,
    points_of,
    value_of,
    wrap_180,
)
from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.own_navigation import fix_of
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import Traffic
from skystack.tasks.centreline import distance_from_leg, distance_from_route
from skystack.tasks.tracking import Memory

LEVELS_PER_MIN = 20.0
"""The rate of level change assumed by the paper's d_xfl: 2,000 feet per minute."""

PerAircraft = Float[Array, "aircraft *batch"]


class Feature(NamedTuple):
    """A feature: its function, its range and its description."""

    value: Callable[[Sector, Traffic, Memory], PerAircraft]
    low: float
    """The value that is scaled to 0."""
    high: float
    """The value that is scaled to 1."""
    exited: float
    """The value for inactive aircraft."""
    meaning: str


def next_fix_turn(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return _turn_to_fix(sector, traffic, memory, ahead=0)


def subsequent_fix_turn(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return _turn_to_fix(sector, traffic, memory, ahead=1)


def centreline_distance(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """d_c"""
    return distance_from_route(sector, traffic)


def leg_distance(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """d_leg"""
    return distance_from_leg(sector, traffic, memory.progress.next_fix)


def time_since_instruction(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return CYCLE_S * memory.counts.cycles_since_instruction


def turn_under_way(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return wrap_180(traffic.cleared_heading_deg - traffic.heading_deg)


def next_fix_distance(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return _distance(sector, traffic, _fix(sector, traffic, memory, ahead=0))


def exit_left_turn(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return _turn_to_exit_corner(sector, traffic, corner=-1)


def exit_right_turn(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    return _turn_to_exit_corner(sector, traffic, corner=0)


def exit_distance(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    middle = np.mean(sector.route_table.exit_ends_nm, axis=1)
    return _distance(sector, traffic, point_of(middle, traffic.route))


def level_to_exit(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """FL_sx: the cleared level minus the exit level."""
    return (traffic.cleared_level_ticks - memory.plan.exit_level_ticks) / TICKS_PER_FL


def entry_to_exit(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """FL_nx: the entry level minus the exit level."""
    return (memory.plan.entry_level_ticks - memory.plan.exit_level_ticks) / TICKS_PER_FL


def distance_in_hand(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """d_xfl: distance [NM] to the exit fix along the route, minus that for the level change."""
    minutes = (
        jnp.abs(memory.plan.exit_level_ticks - traffic.level_ticks) / TICKS_PER_FL / LEVELS_PER_MIN
    )
    return _route_to_exit(sector, traffic, memory) - minutes / 60.0 * traffic.ground_speed_kt


def room_ahead(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """Distance [NM] to the exit edge minus distance to the area's edge, on the cleared heading.

    Zero means that the heading leads out through the exit. Only edges crossed outwards count, so
    before entry the near edge is ignored.
    """
    ray = direction(traffic.cleared_heading_deg)
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    exit_edge = points_of(sector.route_table.exit_edge_nm, traffic.route)
    corners = [(point[:, 0], point[:, 1]) for point in exit_edge]
    to_exit = _nearest_ahead(traffic, ray, pairwise(corners), scale)
    return to_exit - edge_ahead(sector, traffic, memory)


def edge_ahead(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """Distance [NM] to the area's edge on the cleared heading."""
    ray = direction(traffic.cleared_heading_deg)
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    return _nearest_ahead(traffic, ray, edges(sector.area_nm).tolist(), scale)


FEATURES: dict[str, Feature] = {
    "theta_f": Feature(
        next_fix_turn, -180.0, 180.0, 0.0, "turn to the next fix from the cleared heading, deg"
    ),
    "theta_sf": Feature(
        subsequent_fix_turn,
        -180.0,
        180.0,
        0.0,
        "turn to the fix after the next one, from the cleared heading, deg",
    ),
    "d_c": Feature(centreline_distance, -100.0, 100.0, 0.0, "distance right of the route, NM"),
    "d_leg": Feature(
        leg_distance, -100.0, 100.0, 0.0, "distance right of the leg to the next fix, NM"
    ),
    "delta_t": Feature(
        time_since_instruction, 0.0, 60.0, 60.0, "time since the last instruction, s"
    ),
    "delta_t_10": Feature(
        time_since_instruction, 0.0, 10.0, 10.0, "time since the last instruction, at most 10 s"
    ),
    "fl_sx": Feature(level_to_exit, -200.0, 200.0, 0.0, "cleared level minus exit level, FL"),
    "fl_nx": Feature(entry_to_exit, -200.0, 200.0, 0.0, "entry level minus exit level, FL"),
    "d_xfl": Feature(
        distance_in_hand,
        -100.0,
        100.0,
        0.0,
        "distance to the exit fix minus that needed to change level, NM",
    ),
    "theta_turn": Feature(turn_under_way, -180.0, 180.0, 0.0, "cleared minus actual heading, deg"),
    "d_f": Feature(next_fix_distance, 0.0, 100.0, 0.0, "distance to the next fix, NM"),
    "theta_xl": Feature(
        exit_left_turn, -180.0, 180.0, 0.0, "turn to the exit edge's left end, deg"
    ),
    "theta_xr": Feature(
        exit_right_turn, -180.0, 180.0, 0.0, "turn to the exit edge's right end, deg"
    ),
    "d_x": Feature(exit_distance, 0.0, 150.0, 0.0, "distance to the exit edge's middle, NM"),
    "room": Feature(
        room_ahead,
        0.0,
        100.0,
        0.0,
        "distance ahead to the exit edge minus that to the area's edge, NM",
    ),
    "d_edge": Feature(edge_ahead, 0.0, 100.0, 100.0, "distance ahead to the area's edge, NM"),
}


def observe(
    names: tuple[str, ...], sector: Sector, traffic: Traffic, memory: Memory
) -> Float[Array, "observation *batch"]:
    """The named features in [0, 1], aircraft by aircraft."""
    rows = []
    for name in names:
        feature = FEATURES[name]
        value = subroutine(partial(feature.value, sector), traffic, memory)
        observed = jnp.where(traffic.active, value, feature.exited)
        rows.append((observed - feature.low) / (feature.high - feature.low))
    observation = jnp.clip(jnp.stack(rows, axis=1), 0.0, 1.0)
    return observation.reshape(-1, *observation.shape[2:])


def _fix(
    sector: Sector, traffic: Traffic, memory: Memory, ahead: int
) -> Float[Array, "aircraft 2 *batch"]:
    table = sector.route_table
    index = jnp.minimum(memory.progress.next_fix + ahead, value_of(table.last_fix, traffic.route))
    return fix_of(table, traffic.route, index)


def _route_to_exit(sector: Sector, traffic: Traffic, memory: Memory) -> PerAircraft:
    """Distance [NM] to the next fix and along the route to the exit fix; 0 after the exit fix."""
    table = sector.route_table
    exit_fix = value_of(table.exit_fix, traffic.route)
    distance_nm = _distance(sector, traffic, _fix(sector, traffic, memory, ahead=0))
    for number, leg_nm in enumerate(table.leg_nm.T, start=1):
        remaining = (number > memory.progress.next_fix) & (number <= exit_fix)
        distance_nm += jnp.where(remaining, value_of(leg_nm, traffic.route), 0.0)
    return jnp.where(memory.progress.next_fix <= exit_fix, distance_nm, 0.0)


def _distance(
    sector: Sector, traffic: Traffic, point_nm: Float[Array, "aircraft 2 *batch"]
) -> PerAircraft:
    """True distance [NM] of each aircraft from a point, with the scale at the midpoint."""
    offset = point_nm - traffic.position_nm
    return length(offset) / sector.plane.scale(traffic.position_nm[:, 1] + offset[:, 1] / 2.0)


def _turn_to_fix(sector: Sector, traffic: Traffic, memory: Memory, ahead: int) -> PerAircraft:
    offset = _fix(sector, traffic, memory, ahead) - traffic.position_nm
    return wrap_180(bearing(offset) - traffic.cleared_heading_deg)


def _turn_to_exit_corner(sector: Sector, traffic: Traffic, corner: int) -> PerAircraft:
    end = point_of(sector.route_table.exit_ends_nm[:, corner], traffic.route)
    return wrap_180(bearing(end - traffic.position_nm) - traffic.cleared_heading_deg)


def _nearest_ahead(
    traffic: Traffic,
    ray: Float[Array, "aircraft 2 *batch"],
    lines: Iterable[Sequence[Sequence[Any]]],
    scale: PerAircraft,
) -> PerAircraft:
    """True distance [NM] to the nearest edge that a ray crosses outwards, at most 100 NM."""
    nearest, nearest_divisor = 100.0 * scale, jnp.ones_like(scale)
    for start, end in lines:
        distance, divisor = _distance_ahead(traffic, ray, start, end)
        nearer = distance * nearest_divisor < nearest * divisor  # compares the two fractions
        nearest = jnp.where(nearer, distance, nearest)
        nearest_divisor = jnp.where(nearer, divisor, nearest_divisor)
    return nearest / (nearest_divisor * scale)


def _distance_ahead(
    traffic: Traffic,
    ray: Float[Array, "aircraft 2 *batch"],
    start_nm: Sequence[Any],
    end_nm: Sequence[Any],
) -> tuple[PerAircraft, PerAircraft]:
    """Plane distance along a ray from each aircraft to its outward crossing of an edge.

    Returned as a fraction (numerator, denominator), which is 1 / 0 without a crossing. The ends of
    the edge are (east, north), as numbers or per aircraft.
    """
    ray_east, ray_north = ray[:, 0], ray[:, 1]
    edge_east, edge_north = end_nm[0] - start_nm[0], end_nm[1] - start_nm[1]
    east, north = start_nm[0] - traffic.position_nm[:, 0], start_nm[1] - traffic.position_nm[:, 1]
    facing = ray_east * edge_north - ray_north * edge_east
    along_ray = east * edge_north - north * edge_east
    along_edge = east * ray_north - north * ray_east
    hit = (facing > 0.0) & (along_ray > 0.0) & (along_edge >= 0.0) & (along_edge <= facing)
    return jnp.where(hit, along_ray, 1.0), jnp.where(hit, facing, 0.0)
