"""Action tables: the instruction for each action number of a policy."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import wrap_360
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import instruct, turn_to_deg
from skystack.simulator.traffic import NO_TURN, SHORTEST, Clearance, Traffic, ticks
from skystack.tasks.contract import Action, Kind

STEP_DEG = 10
STEP_FL = 10
LARGE_TURNS_DEG = tuple(range(STEP_DEG, 91, STEP_DEG))
STACK_LIMIT_DEG = 180.0
"""The limit of the turn from the actual to the cleared heading. Beyond it, the shorter turn would
be in the other direction."""


@dataclass(frozen=True)
class ActionTable:
    """The instructions of a task, action 0 first. May contain both headings and levels."""

    actions: tuple[Action, ...]
    levels_fl: tuple[int, int] = (0, 600)
    """The lowest and the highest level that can be cleared."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(action.name for action in self.actions)

    @cached_property
    def kinds(self) -> frozenset[Kind]:
        """The kinds of instruction in the table."""
        return frozenset(action.kind for action in self.actions if action.kind is not None)

    def addressed(
        self, traffic: Traffic, action: Int[Array, "*batch"]
    ) -> Bool[Array, "aircraft *batch"]:
        """A mask of the aircraft that an action addresses: one aircraft, or none for action 0."""
        index = [-1 if each.aircraft is None else each.aircraft for each in self.actions]
        aircraft = jnp.arange(traffic.level_ticks.shape[0], dtype=jnp.asarray(index).dtype)
        return aircraft.reshape((-1,) + (1,) * action.ndim) == jnp.asarray(index)[action][None]

    def may_stack(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        """Whether the instruction can be issued.

        The addressed aircraft must be active. A turn must stay below 180 degrees in total, so that
        the aircraft turns in the instructed direction. A level must be within the sector.
        """
        allowed = self.addressed(traffic, action) & traffic.active
        if "heading" in self.kinds:
            turn = turn_to_deg(traffic.heading_deg, traffic.cleared_heading_deg)
            same_direction = jnp.abs(turn + self._change(action, "heading")) < STACK_LIMIT_DEG
            allowed = allowed & (same_direction | self._is_other(action, "heading"))
        if "level" in self.kinds:
            level_ticks = self._changed_ticks(traffic, action)
            within = level_ticks == self._clip(level_ticks)
            allowed = allowed & (within | self._is_other(action, "level"))
        return jnp.any(allowed, axis=0)

    def instruct(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Traffic:
        """Change the cleared heading or level of the addressed aircraft.

        A cleared heading is rounded to a whole number of degrees. A cleared level is clipped to the
        sector's levels.
        """
        addressed = self.addressed(traffic, action)
        turn = jnp.full_like(traffic.route, NO_TURN)
        heading_deg, changes_level = traffic.cleared_heading_deg, jnp.zeros_like(traffic.active)
        level_ticks = traffic.cleared_level_ticks
        if "heading" in self.kinds:
            turns = addressed & ~self._is_other(action, "heading")
            turn = jnp.where(turns, SHORTEST, NO_TURN)
            heading_deg = wrap_360(jnp.round(heading_deg + self._change(action, "heading")))
        if "level" in self.kinds:
            changes_level = addressed & ~self._is_other(action, "level")
            level_ticks = self._clip(self._changed_ticks(traffic, action))
        return instruct(traffic, Clearance(turn, heading_deg, changes_level, level_ticks))

    def _is_other(self, action: Int[Array, "*batch"], kind: Kind) -> Bool[Array, "1 *batch"]:
        """Whether an action is of another kind. The axis of aircraft has length 1."""
        other = [each.kind not in (kind, None) for each in self.actions]
        return jnp.asarray(other)[action][None]

    def _change(self, action: Int[Array, "*batch"], kind: Kind) -> Float[Array, "1 *batch"]:
        """The change of a heading [deg] or a level [FL] by an action; 0 for other kinds."""
        changes = [float(each.change) if each.kind == kind else 0.0 for each in self.actions]
        return jnp.asarray(changes)[action][None]

    def _changed_ticks(
        self, traffic: Traffic, action: Int[Array, "*batch"]
    ) -> Float[Array, "aircraft *batch"]:
        """The cleared levels after an action, before clipping."""
        return traffic.cleared_level_ticks + TICKS_PER_FL * self._change(action, "level")

    def _clip(
        self, level_ticks: Float[Array, "aircraft *batch"]
    ) -> Float[Array, "aircraft *batch"]:
        """Levels clipped to the sector's levels."""
        lowest, highest = (ticks(float(fl)) for fl in self.levels_fl)
        return jnp.clip(level_ticks, lowest, highest)


def _table(actions: Iterable[Action], levels_fl: tuple[int, int] = (0, 600)) -> ActionTable:
    return ActionTable((Action("none"), *actions), levels_fl)


def _changes(aircraft: int, sizes: tuple[int, ...]) -> Iterable[tuple[int, int]]:
    """(aircraft, change) for each action: by aircraft, negative first, small before large."""
    signed = [-size for size in sizes] + list(sizes)
    return ((number, size) for number in range(aircraft) for size in signed)


def small_turns(aircraft: int) -> ActionTable:
    """The paper's action space: left and right by 10 degrees.

    Equation (two_ac_act_space): 5 actions for two aircraft.
    """
    return turns(aircraft, (STEP_DEG,))


def large_turns(aircraft: int) -> ActionTable:
    """The paper's large action space, for reference: left and right by 10 to 90 degrees.

    Equation (2_ac_big_act_space): 37 actions for two aircraft.
    """
    return turns(aircraft, LARGE_TURNS_DEG)


def turns(aircraft: int, sizes_deg: tuple[int, ...]) -> ActionTable:
    """Turns of the given sizes for each aircraft, left before right, small before large."""
    return _table(
        Action(f"aircraft {index + 1} turn {turn:+d} deg", index, "heading", turn)
        for index, turn in _changes(aircraft, sizes_deg)
    )


def level_changes(
    aircraft: int, levels_fl: tuple[int, int], sizes_fl: tuple[int, ...] = (STEP_FL,)
) -> ActionTable:
    """Descents and climbs of the given sizes for each aircraft, within the sector's levels.

    By default of ten flight levels, the paper's vertical action space: 3 actions for one aircraft,
    descend before climb.
    """
    changes = (
        Action(f"aircraft {index + 1} level {step:+d} FL", index, "level", step)
        for index, step in _changes(aircraft, sizes_fl)
    )
    return _table(changes, levels_fl)
