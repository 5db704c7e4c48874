"""The state of the traffic: all that any simulator reports, one row per aircraft."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.projection import MercatorPlane
from skystack.simulator.performance import TICKS_PER_FL

NO_TURN, SHORTEST, LEFT, RIGHT = range(4)
"""How a newly cleared heading is to be turned to; NO_TURN where no heading was cleared."""


class Traffic(NamedTuple):
    """Aircraft in the air. Levels are in ticks (6000 per flight level), see `performance`."""

    position_nm: Float[Array, "aircraft 2 *batch"]
    """East and north of the sector's origin."""
    heading_deg: Float[Array, "aircraft *batch"]
    level_ticks: Float[Array, "aircraft *batch"]
    ground_speed_kt: Float[Array, "aircraft *batch"]
    """Over the last second."""
    vertical_speed_ft_min: Float[Array, "aircraft *batch"]
    """Over the last second."""
    flown_heading_deg: Float[Array, "aircraft *batch"]
    """The heading being turned to or held."""
    turn_deg: Float[Array, "aircraft *batch"]
    """What is left of the turn, positive to the right."""
    flown_level_ticks: Float[Array, "aircraft *batch"]
    """The level being climbed or descended to or held."""
    cleared_heading_deg: Float[Array, "aircraft *batch"]
    """The heading told to the pilot, flown or not yet."""
    cleared_level_ticks: Float[Array, "aircraft *batch"]
    pending_turn: Int[Array, "aircraft *batch"]
    """How to turn to a heading cleared since the last cycle, NO_TURN if none was."""
    own_navigation: Bool[Array, "aircraft *batch"]
    """Following the route without instructions."""
    route: Int[Array, "aircraft *batch"]
    """Index in the sector's routes."""
    next_fix: Int[Array, "aircraft *batch"]
    """Index in the route that own navigation flies to; at the start of a scenario 1 or later."""
    turn_radius_nm: Float[Array, "aircraft *batch"]
    """Radius of a fly-by turn under way, 0 if none."""
    active: Bool[Array, "aircraft *batch"]
    """Inactive aircraft have left, or never were: they do not move."""
    kind: Int[Array, "aircraft *batch"]
    """Index in the types of the performance model."""


class Clearance(NamedTuple):
    """What aircraft are told at one moment; rows without a turn or a level leave it as it is."""

    turn: Int[Array, "aircraft *batch"]
    """NO_TURN, SHORTEST, LEFT or RIGHT."""
    heading_deg: Float[Array, "aircraft *batch"]
    """Absolute, whole degrees in [0, 360); counts where there is a turn."""
    changes_level: Bool[Array, "aircraft *batch"]
    level_ticks: Float[Array, "aircraft *batch"]
    """Absolute, in ticks; counts where the level changes."""


def start(
    position_nm: Float[Array, "aircraft 2 *batch"],
    heading_deg: Float[Array, "aircraft *batch"],
    level_ticks: Float[Array, "aircraft *batch"],
    route: Int[Array, "aircraft *batch"],
    ground_speed_kt: Float[Array, "aircraft *batch"],
    own_navigation: Bool[Array, "aircraft *batch"],
    kind: Int[Array, "aircraft *batch"] | None = None,
) -> Traffic:
    """Aircraft in level flight, cleared to what they fly; of the first kind if none is given."""
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


def callsigns(aircraft: int) -> list[str]:
    """AC1, AC2, ...: of aircraft that nobody has named."""
    return [f"AC{number + 1}" for number in range(aircraft)]


def ticks(fl: float) -> float:
    """Ticks of a flight level, rounded to a whole one."""
    return float(np.round(fl * TICKS_PER_FL))


def trajectory_columns(traffic: Traffic, plane: MercatorPlane) -> dict[str, np.ndarray]:
    """The physical and the cleared values of traffic in the units of the tables.

    Arrays of the shape of the traffic's, whatever it is; float64.
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
