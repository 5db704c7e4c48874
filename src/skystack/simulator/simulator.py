"""The simulator: `instruct` changes what aircraft are cleared to, `advance` flies one radar cycle.

A clearance takes no time and flying does; everything else follows from keeping the two apart. As in
BluebirdDT, `advance` first flies what was being flown and only then adopts what is newly cleared.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from skystack.airspace.geometry import direction, wrap_180, wrap_360
from skystack.airspace.projection import LocalScale
from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.own_navigation import steer
from skystack.simulator.performance import Performance
from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, Clearance, Traffic

CYCLE_S = 6
"""Seconds of a radar cycle, flown in sub-steps of one second."""
TURN_RATE_DEG_S = 1.5


def instruct(traffic: Traffic, clearance: Clearance) -> Traffic:
    """Clear aircraft to headings and levels: nothing physical changes; inactive ones hear none."""
    turned = traffic.active & (clearance.turn != NO_TURN)
    levelled = traffic.active & clearance.changes_level
    return traffic._replace(
        cleared_heading_deg=jnp.where(turned, clearance.heading_deg, traffic.cleared_heading_deg),
        pending_turn=jnp.where(turned, clearance.turn, traffic.pending_turn),
        cleared_level_ticks=jnp.where(levelled, clearance.level_ticks, traffic.cleared_level_ticks),
    )


@dataclass(frozen=True)
class Simulator:
    """Flies traffic in a sector under a performance model."""

    sector: Sector
    performance: Performance
    own_navigation: bool = False
    """Whether any aircraft may follow its route by itself; left out of the program if not."""
    turn_rate_deg_s: float = TURN_RATE_DEG_S

    def advance(self, traffic: Traffic) -> Traffic:
        """One radar cycle of 6 s: active aircraft fly, then adopt what they are cleared to."""
        begun_nm, place = traffic.position_nm, partial(_moved, self.sector.plane.scale)
        flown, moved_nm = traffic, jnp.zeros_like(begun_nm)
        for _ in range(CYCLE_S):
            flown, step_nm = self._fly_one_second(flown)
            # Added up before they meet the position: rounded once, not six times.
            moved_nm += step_nm
            if self.own_navigation:  # which depends on the position
                flown = flown._replace(position_nm=place(begun_nm, moved_nm))
        flown = flown._replace(position_nm=subroutine(place, begun_nm, moved_nm))
        return adopt(_where_active(flown, traffic))

    def level_ground_speed_kt(
        self,
        level_ticks: Float[Array, "aircraft *batch"],
        kind: Int[Array, "aircraft *batch"] | None = None,
    ) -> Float[Array, "aircraft *batch"]:
        """Ground speed in level flight (no wind: the true airspeed)."""
        return self.performance.true_airspeed_kt(level_ticks, jnp.zeros_like(level_ticks), kind)

    def _fly_one_second(
        self, traffic: Traffic
    ) -> tuple[Traffic, Float[Array, "aircraft 2 *batch"]]:
        """Speed, then lateral move, then level: BluebirdDT's order.

        Returns the traffic where it was, and how far it moves [NM, true lengths].
        """
        to_go = traffic.flown_level_ticks - traffic.level_ticks
        phase = jnp.sign(to_go)
        airspeed = self.performance.true_airspeed_kt(traffic.level_ticks, phase, traffic.kind)
        rate = self.performance.vertical_speed_ft_min(traffic.level_ticks, phase, traffic.kind)
        ground_speed = jnp.sqrt(airspeed**2 - (rate * _KT_PER_FT_MIN) ** 2)
        traffic = traffic._replace(ground_speed_kt=ground_speed, vertical_speed_ft_min=rate)
        turn_rate = jnp.full_like(rate, self.turn_rate_deg_s)
        if self.own_navigation:
            traffic, turn_rate = steer(
                traffic, self.sector, turn_rate, self.performance.route_end_nm
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
    """One second of turning at a rate, exact at the target, and the move [NM] along the mid-point
    heading."""
    turned = jnp.clip(traffic.turn_deg, -rate_deg_s, rate_deg_s)
    arrived = jnp.abs(traffic.turn_deg) <= rate_deg_s
    step_nm = (traffic.ground_speed_kt / 3600.0)[:, None] * direction(
        traffic.heading_deg + 0.5 * turned
    )
    heading = wrap_360(traffic.heading_deg + turned)
    turned_traffic = traffic._replace(
        heading_deg=jnp.where(arrived, traffic.flown_heading_deg, heading),
        turn_deg=jnp.where(arrived, 0.0, traffic.turn_deg - turned),
    )
    return turned_traffic, step_nm


def _moved(
    scale: LocalScale,
    position_nm: Float[Array, "aircraft 2 *batch"],
    moved_nm: Float[Array, "aircraft 2 *batch"],
) -> Float[Array, "aircraft 2 *batch"]:
    """Where a true displacement of a cycle or less leads in the plane.

    Over so little the scale is linear in y to a part in ten million: its mean is that half-way.
    """
    local = scale(position_nm[:, 1])
    local += 0.5 * scale.slope(position_nm[:, 1]) * local * moved_nm[:, 1]
    return position_nm + local[:, None] * moved_nm


def adopt(traffic: Traffic) -> Traffic:
    """Begin to fly what has been cleared: headings turn from where the aircraft now points."""
    new = traffic.active & (traffic.pending_turn != NO_TURN)
    turn = turn_to_deg(traffic.heading_deg, traffic.cleared_heading_deg)
    turn = jnp.where((traffic.pending_turn == LEFT) & (turn > 0.0), turn - 360.0, turn)
    turn = jnp.where((traffic.pending_turn == RIGHT) & (turn < 0.0), turn + 360.0, turn)
    own = traffic.own_navigation & ~new
    return traffic._replace(
        flown_heading_deg=jnp.where(new, traffic.cleared_heading_deg, traffic.flown_heading_deg),
        turn_deg=jnp.where(new, turn, traffic.turn_deg),
        flown_level_ticks=jnp.where(
            traffic.active, traffic.cleared_level_ticks, traffic.flown_level_ticks
        ),
        pending_turn=jnp.zeros_like(traffic.pending_turn),
        own_navigation=own,
        # An aircraft that navigates by itself is cleared to whatever heading it takes.
        cleared_heading_deg=jnp.where(own, traffic.heading_deg, traffic.cleared_heading_deg),
    )


def turn_to_deg(
    heading_deg: Float[Array, "*n"], target_deg: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """The shorter turn to a heading, positive to the right; half a turn passes through no north."""
    turn = wrap_180(target_deg - heading_deg)
    return jnp.where((turn == -180.0) & (target_deg > heading_deg), 180.0, turn)


def _where_active(flown: Traffic, parked: Traffic) -> Traffic:
    """Active aircraft as flown, the others as they were."""

    def pick(new: Array, old: Array) -> Array:
        active = parked.active if new.ndim == parked.active.ndim else parked.active[:, None]
        return jnp.where(active, new, old)

    return jax.tree.map(pick, flown, parked)
