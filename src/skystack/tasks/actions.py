"""Action tables: which instruction each number of a policy's output stands for."""

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import wrap_360
from skystack.simulator.simulator import instruct, turn_to_deg
from skystack.simulator.traffic import NO_TURN, SHORTEST, Clearance, Traffic

STEP_DEG = 10
STACK_LIMIT_DEG = 180.0
"""A cleared heading this far from the actual one would be turned to the other way."""


@dataclass(frozen=True)
class TurnTable:
    """Turns of whole multiples of ten degrees for each aircraft; action 0 is none.

    Equations (two_ac_act_space) with one size, 5 actions for two aircraft, and
    (2_ac_big_act_space) with nine, 37 actions: left before right, small before large.
    """

    aircraft: int
    sizes_deg: tuple[int, ...]

    @cached_property
    def turns(self) -> tuple[tuple[int, int], ...]:
        """(aircraft, degrees to the right) of action 1, 2, ..."""
        sizes = [-size for size in self.sizes_deg] + list(self.sizes_deg)
        return tuple((aircraft, size) for aircraft in range(self.aircraft) for size in sizes)

    @property
    def names(self) -> tuple[str, ...]:
        """Readable names, "none" first."""
        return (
            "none",
            *(f"aircraft {who + 1} turn {turn:+d} deg" for who, turn in self.turns),
        )

    def addressed(self, action: Int[Array, ""]) -> Bool[Array, " aircraft"]:
        """Which aircraft an action is for: none or one."""
        who = jnp.asarray([-1, *(aircraft for aircraft, _ in self.turns)])
        return jnp.arange(self.aircraft) == who[action]

    def turn_deg(self, action: Int[Array, ""]) -> Float[Array, ""]:
        """The change of cleared heading."""
        return jnp.asarray([0.0, *(float(turn) for _, turn in self.turns)])[action]

    def may_stack(self, traffic: Traffic, action: Int[Array, ""]) -> Bool[Array, ""]:
        """Whether the aircraft is there and would still turn the way it is told."""
        turn = turn_to_deg(traffic.heading_deg, traffic.cleared_heading_deg)
        allowed = jnp.abs(turn + self.turn_deg(action)) < STACK_LIMIT_DEG
        return jnp.any(self.addressed(action) & traffic.active & allowed)

    def instruct(self, traffic: Traffic, action: Int[Array, ""]) -> Traffic:
        """Change the cleared heading, which is a whole number of degrees afterwards."""
        heading = jnp.round(traffic.cleared_heading_deg + self.turn_deg(action))
        return instruct(
            traffic,
            Clearance(
                turn=jnp.where(self.addressed(action), SHORTEST, NO_TURN),
                heading_deg=wrap_360(heading),
                changes_level=jnp.zeros(self.aircraft, dtype=bool),
                level=traffic.cleared_level,
            ),
        )


def small_turns(aircraft: int) -> TurnTable:
    """The paper's action space: left and right by 10 degrees."""
    return TurnTable(aircraft, (STEP_DEG,))


def large_turns(aircraft: int) -> TurnTable:
    """The paper's reference: left and right by 10 to 90 degrees."""
    return TurnTable(aircraft, tuple(range(STEP_DEG, 91, STEP_DEG)))
