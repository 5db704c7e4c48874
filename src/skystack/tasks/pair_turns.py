"""Predicted closest approaches of aircraft that turn to their cleared headings.

A turn of 90 degrees takes one minute, in which an aircraft at 420 kt flies seven miles. So a
prediction straight along the cleared headings can be wrong by several miles.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from skystack.airspace.geometry import direction, dot
from skystack.simulator.simulator import CYCLE_S, TURN_RATE_DEG_S, pending_turn_deg
from skystack.simulator.traffic import NO_TURN, Traffic

TIMES_S = tuple(range(0, 121, 20))
"""Between these times, the relative motion of two aircraft is taken to be straight, and also after
the last one, when turns of up to 170 degrees have ended."""

PerPair = Float[Array, "pairs *batch"]


class Turning(NamedTuple):
    """Aircraft on their way to their cleared headings."""

    heading_deg: Float[Array, "aircraft *batch"]
    """The present heading."""
    turn_deg: Float[Array, "aircraft *batch"]
    """The turn to the cleared heading, positive to the right."""
    delay_s: Float[Array, "aircraft *batch"]
    """The time until the turn begins."""
    speed_kt: Float[Array, "aircraft *batch"]

    def moved_nm(self, time_s: float) -> Float[Array, "aircraft 2 *batch"]:
        """The displacement until a time: straight flight, the turn, and straight flight."""
        needed_s = jnp.abs(self.turn_deg) / TURN_RATE_DEG_S
        turning_s = jnp.clip(time_s - self.delay_s, 0.0, needed_s)
        half_deg = 0.5 * TURN_RATE_DEG_S * turning_s
        chord = jnp.sinc(half_deg / 180.0)  # the ratio of the chord to the arc
        middle_deg = self.heading_deg + jnp.sign(self.turn_deg) * half_deg
        after_s = jnp.maximum(time_s - self.delay_s - needed_s, 0.0)
        moved_s = (
            jnp.minimum(time_s, self.delay_s)[:, None] * direction(self.heading_deg)
            + (turning_s * chord)[:, None] * direction(middle_deg)
            + after_s[:, None] * direction(self.heading_deg + self.turn_deg)
        )
        return (self.speed_kt / 3600.0)[:, None] * moved_s


def turning(traffic: Traffic) -> Turning:
    """All aircraft. A newly cleared heading is turned to after one cycle of straight flight."""
    new = traffic.pending_turn != NO_TURN
    return Turning(
        heading_deg=traffic.heading_deg,
        turn_deg=jnp.where(new, pending_turn_deg(traffic), traffic.turn_deg),
        delay_s=jnp.where(new, float(CYCLE_S), 0.0),
        speed_kt=traffic.ground_speed_kt,
    )


def closest_with_turns(
    offset_nm: Float[Array, "pairs 2 *batch"],
    first: Turning,
    second: Turning,
    velocity_kt: Float[Array, "pairs 2 *batch"],
    horizon_h: PerPair,
) -> tuple[PerPair, PerPair]:
    """The closest approach [NM] within a horizon, and the time until then [h].

    `offset_nm` is from the first aircraft to the second, and `velocity_kt` that of the second
    relative to the first after both turns.
    """
    offsets = [offset_nm + second.moved_nm(time) - first.moved_nm(time) for time in TIMES_S]
    least2, when_h = dot(offset_nm, offset_nm), jnp.zeros_like(horizon_h)
    for number, start_s in enumerate(TIMES_S):
        offset, start_h = offsets[number], start_s / 3600.0
        if start_s == TIMES_S[-1]:
            lasts_h, velocity = horizon_h - start_h, velocity_kt
        else:
            lasts_h = jnp.full_like(horizon_h, (TIMES_S[number + 1] - start_s) / 3600.0)
            velocity = (offsets[number + 1] - offset) / lasts_h[:, None]
        speed2 = jnp.maximum(dot(velocity, velocity), 1.0)
        nearest_h = jnp.clip(-dot(offset, velocity) / speed2, 0.0, lasts_h)
        nearest = offset + nearest_h[:, None] * velocity
        distance2 = dot(nearest, nearest)
        closer = distance2 < least2
        least2 = jnp.where(closer, distance2, least2)
        when_h = jnp.where(closer, start_h + nearest_h, when_h)
    return jnp.sqrt(least2), when_h
