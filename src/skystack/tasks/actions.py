"""Action tables: which instruction each number of a policy's output stands for."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import wrap_360
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import instruct, turn_to_deg
from skystack.simulator.traffic import NO_TURN, SHORTEST, Clearance, Traffic, ticks

Kind = Literal["heading", "level"]

STEP_DEG = 10
STEP_FL = 10
STACK_LIMIT_DEG = 180.0
"""A cleared heading this far from the actual one would be turned to the other way."""


@runtime_checkable
class ActionTable(Protocol):
    """What the instructions of a task are; action 0 is none."""

    @property
    def kind(self) -> Kind:
        """What an instruction clears."""

    @property
    def changes(self) -> tuple[tuple[int, int], ...]:
        """(aircraft, by how much) of action 1, 2, ..."""

    @property
    def names(self) -> tuple[str, ...]:
        """Readable names, "none" first."""

    def may_stack(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Whether the instruction can be given: the aircraft is there, the value within limits."""

    def instruct(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Traffic: ...


def addressed(
    table: ActionTable, traffic: Traffic, action: Int[Array, "*batch"]
) -> Bool[Array, "aircraft *batch"]:
    """Which aircraft an action is for: none or one."""
    who = jnp.asarray([-1, *(aircraft for aircraft, _ in table.changes)])
    aircraft = jnp.arange(traffic.level_ticks.shape[0], dtype=who.dtype)
    return aircraft.reshape((-1,) + (1,) * action.ndim) == who[action][None]


def _change(table: ActionTable, action: Int[Array, "*batch"]) -> Float[Array, "1 *batch"]:
    """Of the one aircraft that it is for; the axis of aircraft has length 1."""
    return jnp.asarray([0.0, *(float(change) for _, change in table.changes)])[action][None]


def _every(aircraft: int, sizes: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Minus before plus, small before large, aircraft by aircraft."""
    signed = [-size for size in sizes] + list(sizes)
    return tuple((number, size) for number in range(aircraft) for size in signed)


@dataclass(frozen=True)
class TurnTable:
    """Turns of whole multiples of ten degrees for each aircraft, to the right positive.

    Equations (two_ac_act_space) with one size, 5 actions for two aircraft, and
    (2_ac_big_act_space) with nine, 37 actions: left before right, small before large.
    """

    aircraft: int
    sizes_deg: tuple[int, ...] = (STEP_DEG,)

    @property
    def kind(self) -> Kind:
        return "heading"

    @cached_property
    def changes(self) -> tuple[tuple[int, int], ...]:
        return _every(self.aircraft, self.sizes_deg)

    @property
    def names(self) -> tuple[str, ...]:
        return (
            "none",
            *(f"aircraft {who + 1} turn {turn:+d} deg" for who, turn in self.changes),
        )

    def may_stack(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Whether the aircraft is there and would still turn the way it is told."""
        turn = turn_to_deg(traffic.heading_deg, traffic.cleared_heading_deg)
        allowed = jnp.abs(turn + _change(self, action)) < STACK_LIMIT_DEG
        return jnp.any(addressed(self, traffic, action) & traffic.active & allowed, axis=0)

    def instruct(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Traffic:
        """Change the cleared heading, which is a whole number of degrees afterwards."""
        heading = jnp.round(traffic.cleared_heading_deg + _change(self, action))
        return instruct(
            traffic,
            Clearance(
                turn=jnp.where(addressed(self, traffic, action), SHORTEST, NO_TURN),
                heading_deg=wrap_360(heading),
                changes_level=jnp.zeros_like(traffic.active),
                level_ticks=traffic.cleared_level_ticks,
            ),
        )


@dataclass(frozen=True)
class LevelTable:
    """Climbs and descents by ten flight levels for each aircraft, inside the sector's levels.

    The paper's vertical action space: 3 actions for one aircraft, descend before climb.
    """

    aircraft: int
    levels_fl: tuple[int, int]

    @property
    def kind(self) -> Kind:
        return "level"

    @cached_property
    def changes(self) -> tuple[tuple[int, int], ...]:
        return _every(self.aircraft, (STEP_FL,))

    @property
    def names(self) -> tuple[str, ...]:
        return ("none", *(f"aircraft {who + 1} level {step:+d} FL" for who, step in self.changes))

    def may_stack(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Whether the aircraft is there and the level it would be cleared to is in the sector."""
        wanted = self._wanted(traffic, action)
        allowed = wanted == self._within(wanted)
        return jnp.any(addressed(self, traffic, action) & traffic.active & allowed, axis=0)

    def instruct(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Traffic:
        """Change the cleared level; at the limit of the sector it stays."""
        return instruct(
            traffic,
            Clearance(
                turn=jnp.full_like(traffic.route, NO_TURN),
                heading_deg=traffic.cleared_heading_deg,
                changes_level=addressed(self, traffic, action),
                level_ticks=self._within(self._wanted(traffic, action)),
            ),
        )

    def _wanted(
        self, traffic: Traffic, action: Int[Array, "*batch"]
    ) -> Float[Array, "aircraft *batch"]:
        return traffic.cleared_level_ticks + TICKS_PER_FL * _change(self, action)

    def _within(
        self, level_ticks: Float[Array, "aircraft *batch"]
    ) -> Float[Array, "aircraft *batch"]:
        lowest, highest = (ticks(float(fl)) for fl in self.levels_fl)
        return jnp.clip(level_ticks, lowest, highest)


def small_turns(aircraft: int) -> TurnTable:
    """The paper's action space: left and right by 10 degrees."""
    return TurnTable(aircraft)


def large_turns(aircraft: int) -> TurnTable:
    """The paper's reference: left and right by 10 to 90 degrees."""
    return TurnTable(aircraft, tuple(range(STEP_DEG, 91, STEP_DEG)))
