"""The simulator: `instruct` changes what aircraft are cleared to, `advance` flies one radar cycle.

Issuing a clearance takes no simulated time; only `advance` moves aircraft. As in BluebirdDT, a
clearance takes effect one cycle after it is issued: `advance` first flies the adopted clearances
and then adopts the new ones.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import AnyArray, direction, wrap_180, wrap_360
from skystack.airspace.projection import LocalScale
from skystack.airspace.sector import Sector
from skystack.compilation.loops import repeated
from skystack.compilation.subroutine import subroutine
from skystack.simulator.own_navigation import steer
from skystack.simulator.performance import Performance
from skystack.simulator.traffic import (
    DIRECT,
    LEFT,
    NO_TURN,
    RADIUS_UNKNOWN,
    RIGHT,
    Clearance,
    Traffic,
    where_aircraft,
)

CYCLE_S = 6
"""The length of a radar cycle in seconds, flown in sub-steps of one second."""
TURN_RATE_DEG_S = 1.5


def instruct(traffic: Traffic, clearance: Clearance) -> Traffic:
    """Clear active aircraft to headings, fixes and levels. No physical state changes.

    A heading replaces a fix that was cleared in the same cycle, and the other way round.
    """
    turned = traffic.active & (clearance.turn != NO_TURN)
    levelled = traffic.active & clearance.changes_level
    to_heading, cleared_fix = turned, traffic.cleared_fix
    if cleared_fix is not None and clearance.fix is not None:
        to_fix = turned & (clearance.turn == DIRECT)
        to_heading = turned & ~to_fix
        cleared_fix = jnp.where(to_fix, clearance.fix, cleared_fix)
    return traffic._replace(
        cleared_fix=cleared_fix,
        cleared_heading_deg=jnp.where(
            to_heading, clearance.heading_deg, traffic.cleared_heading_deg
        ),
        pending_turn=jnp.where(turned, clearance.turn, traffic.pending_turn),
        cleared_level_ticks=jnp.where(levelled, clearance.level_ticks, traffic.cleared_level_ticks),
    )


@dataclass(frozen=True)
class Simulator:
    """Flies traffic in a sector with a performance model."""

    sector: Sector
    performance: Performance
    own_navigation: bool = False
    """Whether aircraft may be on own navigation. If False, compiled programs omit it."""
    turn_rate_deg_s: float = TURN_RATE_DEG_S
    route_turn_deg_s: float | None = None
    """The rate of turns on own navigation; None for coordinated turns. Outlooks always assume
    coordinated turns, and 1.5 degrees per second to headings."""

    def advance(self, traffic: Traffic) -> Traffic:
        """One radar cycle of 6 s: active aircraft fly, then adopt their new clearances."""
        start_nm, move = traffic.position_nm, partial(_moved, self.sector.plane.scale)

        def fly(flying: tuple[Traffic, Array], _: Any) -> tuple[tuple[Traffic, Array], None]:
            flown, step_nm = self._fly_one_second(flying[0])
            # Summing the steps first rounds the position once, not six times.
            moved_nm = flying[1] + step_nm
            if self.own_navigation:  # steering needs the current position
                flown = flown._replace(position_nm=move(start_nm, moved_nm))
            return (flown, moved_nm), None

        begun = (traffic, jnp.zeros_like(start_nm))
        (flown, moved_nm), _ = repeated(fly, begun, CYCLE_S, unrolled=not self.own_navigation)
        flown = flown._replace(position_nm=subroutine(move, start_nm, moved_nm))
        return adopt(where_aircraft(traffic.active, flown, traffic))

    def level_ground_speed_kt(
        self,
        level_ticks: Float[Array, "aircraft *batch"],
        kind: Int[Array, "aircraft *batch"] | None = None,
    ) -> Float[Array, "aircraft *batch"]:
        """Ground speed in level flight. Without wind it equals the true airspeed."""
        return self.performance.true_airspeed_kt(level_ticks, jnp.zeros_like(level_ticks), kind)

    def true_airspeed_kt(self, traffic: Traffic) -> Float[Array, "aircraft *batch"]:
        """The true airspeed on the way to the levels that have been adopted."""
        phase = jnp.sign(traffic.flown_level_ticks - traffic.level_ticks)
        airspeed = self.performance.true_airspeed_kt(traffic.level_ticks, phase, traffic.kind)
        return airspeed if traffic.airspeed_factor is None else airspeed * traffic.airspeed_factor

    def _fly_one_second(
        self, traffic: Traffic
    ) -> tuple[Traffic, Float[Array, "aircraft 2 *batch"]]:
        """Update the speed, the heading and then the level, in BluebirdDT's order.

        Returns the traffic with its position unchanged, and its displacement [NM, true length].
        """
        to_go = traffic.flown_level_ticks - traffic.level_ticks
        phase = jnp.sign(to_go)
        airspeed = self.true_airspeed_kt(traffic)
        rate = self.performance.vertical_speed_ft_min(traffic.level_ticks, phase, traffic.kind)
        if traffic.climb_factor is not None:
            rate = jnp.round(rate * traffic.climb_factor)  # whole ticks, which are exact
        ground_speed = jnp.sqrt(airspeed**2 - (rate * _KT_PER_FT_MIN) ** 2)
        traffic = traffic._replace(ground_speed_kt=ground_speed, vertical_speed_ft_min=rate)
        turn_rate = jnp.full_like(rate, self.turn_rate_deg_s)
        if self.own_navigation:
            traffic, turn_rate = steer(
                traffic,
                self.sector,
                turn_rate,
                self.performance.route_end_nm,
                self.route_turn_deg_s,
            )
        captured = jnp.abs(to_go) <= jnp.abs(rate)
        level_ticks = jnp.where(captured, traffic.flown_level_ticks, traffic.level_ticks + rate)
        turned, step_nm = _turn(traffic, turn_rate)
        vertical_speed = jnp.where(captured, 0.0, rate)
        return turned._replace(
            level_ticks=level_ticks, vertical_speed_ft_min=vertical_speed
        ), step_nm


_KT_PER_FT_MIN = 0.3048 * 60.0 / 1852.0


def _turn(
    traffic: Traffic, rate_deg_s: Float[Array, "aircraft *batch"]
) -> tuple[Traffic, Float[Array, "aircraft 2 *batch"]]:
    """Turn for one second at a rate, with an exact final heading.

    Returns the traffic, and the displacement [NM] along the heading at the middle of the second.
    """
    turned = jnp.clip(traffic.turn_deg, -rate_deg_s, rate_deg_s)
    completed = jnp.abs(traffic.turn_deg) <= rate_deg_s
    step_nm = (traffic.ground_speed_kt / 3600.0)[:, None] * direction(
        traffic.heading_deg + 0.5 * turned
    )
    heading = wrap_360(traffic.heading_deg + turned)
    turned_traffic = traffic._replace(
        heading_deg=jnp.where(completed, traffic.flown_heading_deg, heading),
        turn_deg=jnp.where(completed, 0.0, traffic.turn_deg - turned),
    )
    return turned_traffic, step_nm


def _moved(
    scale: LocalScale,
    position_nm: Float[Array, "aircraft 2 *batch"],
    moved_nm: Float[Array, "aircraft 2 *batch"],
) -> Float[Array, "aircraft 2 *batch"]:
    """The plane position after a true displacement of at most one cycle.

    Over this distance the scale is linear in y to one part in ten million, so the mean scale is the
    scale at the midpoint.
    """
    local = scale(position_nm[:, 1])
    local += 0.5 * scale.slope(position_nm[:, 1]) * local * moved_nm[:, 1]
    return position_nm + local[:, None] * moved_nm


def adopt(traffic: Traffic) -> Traffic:
    """Adopt new clearances. Turns are computed from the current heading of the aircraft."""
    new = traffic.active & (traffic.pending_turn != NO_TURN)
    if traffic.cleared_fix is not None:
        traffic, new = _adopt_direct(traffic, traffic.cleared_fix, new)
    turn = pending_turn_deg(traffic)
    own = traffic.own_navigation & ~new
    return traffic._replace(
        flown_heading_deg=jnp.where(new, traffic.cleared_heading_deg, traffic.flown_heading_deg),
        turn_deg=jnp.where(new, turn, traffic.turn_deg),
        flown_level_ticks=jnp.where(
            traffic.active, traffic.cleared_level_ticks, traffic.flown_level_ticks
        ),
        pending_turn=jnp.zeros_like(traffic.pending_turn),
        own_navigation=own,
        # On own navigation the cleared heading follows the actual heading.
        cleared_heading_deg=jnp.where(own, traffic.heading_deg, traffic.cleared_heading_deg),
    )


def pending_turn_deg(traffic: Traffic) -> Float[Array, "aircraft *batch"]:
    """The turn to the cleared heading in the direction of `pending_turn`."""
    turn = turn_to_deg(traffic.heading_deg, traffic.cleared_heading_deg)
    turn = jnp.where((traffic.pending_turn == LEFT) & (turn > 0.0), turn - 360.0, turn)
    return jnp.where((traffic.pending_turn == RIGHT) & (turn < 0.0), turn + 360.0, turn)


def _adopt_direct(
    traffic: Traffic,
    cleared_fix: Int[Array, "aircraft *batch"],
    new: Bool[Array, "aircraft *batch"],
) -> tuple[Traffic, Bool[Array, "aircraft *batch"]]:
    """Put aircraft cleared direct to a fix on own navigation. Returns the other new clearances."""
    direct = new & (traffic.pending_turn == DIRECT)
    adopted = traffic._replace(
        own_navigation=traffic.own_navigation | direct,
        next_fix=jnp.where(direct, cleared_fix, traffic.next_fix),
        turn_radius_nm=jnp.where(direct, RADIUS_UNKNOWN, traffic.turn_radius_nm),
    )
    return adopted, new & ~direct


def turn_to_deg(
    heading_deg: Float[AnyArray, "*n"], target_deg: Float[AnyArray, "*n"]
) -> Float[AnyArray, "*n"]:
    """The shorter turn to a heading, positive to the right, in JAX or numpy.

    A turn of exactly 180 degrees takes the direction that does not pass through north.
    """
    turn = wrap_180(target_deg - heading_deg)
    library: Any = turn.__array_namespace__()
    return library.where((turn == -180.0) & (target_deg > heading_deg), 180.0, turn)
