"""The state of the traffic as any simulator can report it, with one row per aircraft."""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.projection import MercatorPlane
from skystack.simulator.performance import TICKS_PER_FL

Tree = TypeVar("Tree")

NO_TURN, SHORTEST, LEFT, RIGHT, DIRECT = range(5)
"""Directions of the turn to a newly cleared heading; NO_TURN means that none was cleared, DIRECT
that the aircraft was cleared direct to a fix instead."""

RADIUS_UNKNOWN = -1.0
"""Stands for the radius of the turn to a newly cleared fix until it is computed."""


class Traffic(NamedTuple):
    """The aircraft of a scenario. Levels are in ticks, 6000 per flight level; see `performance`."""

    position_nm: Float[Array, "aircraft 2 *batch"]
    """East and north of the sector's origin in the plane."""
    heading_deg: Float[Array, "aircraft *batch"]
    level_ticks: Float[Array, "aircraft *batch"]
    ground_speed_kt: Float[Array, "aircraft *batch"]
    """The ground speed during the last second."""
    vertical_speed_ft_min: Float[Array, "aircraft *batch"]
    """The vertical speed during the last second; 0 once the level is reached."""
    flown_heading_deg: Float[Array, "aircraft *batch"]
    """The heading that the aircraft turns to or holds."""
    turn_deg: Float[Array, "aircraft *batch"]
    """The remaining turn, positive to the right."""
    flown_level_ticks: Float[Array, "aircraft *batch"]
    """The level that the aircraft climbs to, descends to or holds."""
    cleared_heading_deg: Float[Array, "aircraft *batch"]
    """The cleared heading, adopted or not."""
    cleared_level_ticks: Float[Array, "aircraft *batch"]
    """The cleared level, adopted or not."""
    pending_turn: Int[Array, "aircraft *batch"]
    """The direction of the turn to a heading cleared since the last cycle, DIRECT, or NO_TURN."""
    own_navigation: Bool[Array, "aircraft *batch"]
    """Whether the aircraft follows its route without instructions."""
    route: Int[Array, "aircraft *batch"]
    """Index of the route in the sector's routes."""
    next_fix: Int[Array, "aircraft *batch"]
    """Index in the route of the fix that own navigation flies to; at least 1 at the start."""
    turn_radius_nm: Float[Array, "aircraft *batch"]
    """Radius of the current fly-by turn or turn direct to a fix; 0 if there is none, or
    RADIUS_UNKNOWN."""
    active: Bool[Array, "aircraft *batch"]
    """Inactive aircraft have left the scenario, or the row is unused. They do not move."""
    kind: Int[Array, "aircraft *batch"]
    """Index of the type in the types of the performance model."""
    cleared_fix: Int[Array, "aircraft *batch"] | None = None
    """Index in the route of the fix cleared direct to. None if aircraft are not cleared to fixes;
    compiled programs then omit it, as they do the factors below."""
    airspeed_factor: Float[Array, "aircraft *batch"] | None = None
    """Multiplies the airspeed of the performance model; None means 1."""
    climb_factor: Float[Array, "aircraft *batch"] | None = None
    """Multiplies the rates of climb and descent of the performance model; None means 1."""

    @property
    def cleared_along_route(self) -> Any:
        """Whether aircraft are cleared to follow their routes, adopted or not.

        `[aircraft, *batch]`, in numpy if the traffic is.
        """
        on_own = self.own_navigation & (self.pending_turn == NO_TURN)
        return on_own | (self.pending_turn == DIRECT)


class Clearance(NamedTuple):
    """Clearances to all aircraft at one time. Headings and levels without one stay unchanged."""

    turn: Int[Array, "aircraft *batch"]
    """NO_TURN, SHORTEST, LEFT, RIGHT or DIRECT."""
    heading_deg: Float[Array, "aircraft *batch"]
    """Absolute heading, whole degrees in [0, 360). Ignored with NO_TURN and DIRECT."""
    changes_level: Bool[Array, "aircraft *batch"]
    level_ticks: Float[Array, "aircraft *batch"]
    """Absolute level in ticks. Ignored unless `changes_level`."""
    fix: Int[Array, "aircraft *batch"] | None = None
    """Index in the route of the fix to fly to on own navigation. Ignored unless DIRECT."""


def start(
    position_nm: Float[Array, "aircraft 2 *batch"],
    heading_deg: Float[Array, "aircraft *batch"],
    level_ticks: Float[Array, "aircraft *batch"],
    route: Int[Array, "aircraft *batch"],
    ground_speed_kt: Float[Array, "aircraft *batch"],
    own_navigation: Bool[Array, "aircraft *batch"],
    kind: Int[Array, "aircraft *batch"] | None = None,
) -> Traffic:
    """Aircraft in level flight, cleared to their headings and levels.

    All are of the first type unless `kind` is given.
    """
    zero = jnp.zeros_like(heading_deg)
    return Traffic(
        position_nm=position_nm,
        heading_deg=heading_deg,
        level_ticks=level_ticks,
        ground_speed_kt=ground_speed_kt,
        vertical_speed_ft_min=zero,
        flown_heading_deg=heading_deg,
        turn_deg=zero,
        flown_level_ticks=level_ticks,
        cleared_heading_deg=heading_deg,
        cleared_level_ticks=level_ticks,
        pending_turn=jnp.zeros_like(route),
        own_navigation=own_navigation,
        route=route,
        next_fix=jnp.ones_like(route),
        turn_radius_nm=zero,
        active=jnp.ones_like(own_navigation),
        kind=jnp.zeros_like(route) if kind is None else kind,
    )


def where_aircraft(mask: Bool[Array, "aircraft *batch"], yes: Tree, no: Tree) -> Tree:
    """Select from two pytrees of arrays, aircraft by aircraft.

    An array has the axes of the mask, or one more after that of the aircraft.
    """

    def pick(a: Array, b: Array) -> Array:
        return jnp.where(mask if b.ndim == mask.ndim else mask[:, None], a, b)

    picked: Tree = jax.tree.map(pick, yes, no)
    return picked


def callsigns(aircraft: int) -> list[str]:
    """The default callsigns AC1, AC2, ..."""
    return [f"AC{number + 1}" for number in range(aircraft)]


def ticks(fl: float) -> float:
    """A flight level in ticks, rounded to a whole number."""
    return float(np.round(fl * TICKS_PER_FL))


def trajectory_columns(traffic: Traffic, plane: MercatorPlane) -> dict[str, np.ndarray]:
    """The physical and the cleared values of traffic in the units of the tables.

    The arrays have the shape of the traffic's arrays and are float64.
    """
    degrees = plane.to_degrees(traffic.position_nm)
    columns = {
        "lat": degrees[..., 0],
        "lon": degrees[..., 1],
        "fl": np.asarray(traffic.level_ticks, dtype=np.float64) / TICKS_PER_FL,
        "heading_deg": traffic.heading_deg,
        "cleared_heading_deg": traffic.cleared_heading_deg,
        "cleared_fl": np.asarray(traffic.cleared_level_ticks, dtype=np.float64) / TICKS_PER_FL,
        "ground_speed_kt": traffic.ground_speed_kt,
        "vertical_speed_ft_min": traffic.vertical_speed_ft_min,
    }
    return {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
