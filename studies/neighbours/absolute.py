"""Absolute clearances, "fly heading 240" and "climb to FL240", instead of changes of ten."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import instruct
from skystack.simulator.traffic import NO_TURN, SHORTEST, Clearance, Traffic
from skystack.tasks.actions import STEP_FL, ActionTable, level_changes, turns
from skystack.tasks.contract import Action, Kind
from skystack.tasks.features import FEATURES
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.wrapper import TaskWrapper

HIGHEST_FL = 600.0
ANGLES = ("theta_f", "theta_sf")
"""The features that give the turn from the cleared heading to each of the next two fixes."""


@dataclass(frozen=True)
class AbsoluteTable(ActionTable):
    """An action table whose `change` is the new value itself.

    A value that is already cleared is not issued again, so it does not count as an instruction.
    """

    def addressed(
        self, traffic: Traffic, action: Int[Array, "*batch"]
    ) -> Bool[Array, "aircraft *batch"]:
        heading_deg, level_ticks = self._values(action)
        other_heading = traffic.cleared_heading_deg != heading_deg
        other_level = traffic.cleared_level_ticks != level_ticks
        other = other_heading if "heading" in self.kinds else other_level
        return super().addressed(traffic, action) & other

    def may_stack(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        return jnp.any(self.addressed(traffic, action) & traffic.active, axis=0)

    def instruct(self, traffic: Traffic, action: Int[Array, "*batch"]) -> Traffic:
        addressed = self.addressed(traffic, action)
        heading_deg, level_ticks = self._values(action)
        turned = addressed & ("heading" in self.kinds)
        return instruct(
            traffic,
            Clearance(
                jnp.where(turned, SHORTEST, NO_TURN),
                jnp.where(turned, heading_deg, traffic.cleared_heading_deg),
                addressed & ("level" in self.kinds),
                jnp.broadcast_to(level_ticks, addressed.shape),
            ),
        )

    def _values(
        self, action: Int[Array, "*batch"]
    ) -> tuple[Float[Array, "1 *batch"], Float[Array, "1 *batch"]]:
        """The heading [deg] and the level [ticks] of an action."""
        level_fl = self._change(action, "level")
        return self._change(action, "heading"), TICKS_PER_FL * level_fl


def absolute_headings(aircraft: int, step_deg: int) -> AbsoluteTable:
    """Every heading that is a multiple of `step_deg`, for each aircraft."""
    return AbsoluteTable(_actions(aircraft, "heading", range(0, 360, step_deg)))


def absolute_levels(aircraft: int, levels_fl: tuple[int, int]) -> AbsoluteTable:
    """Every tenth flight level of the sector, for each aircraft."""
    lowest, highest = levels_fl
    return AbsoluteTable(_actions(aircraft, "level", range(lowest, highest + 1, STEP_FL)))


def _actions(aircraft: int, kind: Kind, values: range) -> tuple[Action, ...]:
    named = (
        Action(f"aircraft {index + 1} {kind} {value:03d}", index, kind, value)
        for index in range(aircraft)
        for value in values
    )
    return (Action("none"), *named)


@dataclass(frozen=True)
class WithAbsoluteValues(TaskWrapper[NavigationTask]):
    """A task whose observation also has the absolute values of the actions.

    For each aircraft: the cleared heading and the bearings to the next two fixes, as sine and
    cosine, the cleared level and the exit level. The paper's features are relative to the
    cleared values.
    """

    @property
    def observation_names(self) -> tuple[str, ...]:
        kinds = (f"{part} {angle}" for angle in ("heading", *ANGLES) for part in ("sin", "cos"))
        names = (*kinds, "cleared level", "exit level")
        aircraft = range(1, self.task.aircraft + 1)
        each = (f"{name} {number}" for name in names for number in aircraft)
        return (*self.task.observation_names, *each)

    def observe(self, state: NavigationState) -> Float[Array, "observation *batch"]:
        traffic, sector = state.traffic, self.task.sector
        heading_deg = traffic.cleared_heading_deg
        turns_deg = [FEATURES[name].value(sector, traffic, state.memory) for name in ANGLES]
        bearings_deg = [heading_deg, *(heading_deg + turn_deg for turn_deg in turns_deg)]
        angles = [jnp.radians(bearing_deg) for bearing_deg in bearings_deg]
        parts = [0.5 + 0.5 * part(angle) for angle in angles for part in (jnp.sin, jnp.cos)]
        levels = [traffic.cleared_level_ticks, state.memory.plan.exit_level_ticks]
        scaled = [level / TICKS_PER_FL / HIGHEST_FL for level in levels]
        return jnp.concatenate([self.task.observe(state), *parts, *scaled])


def with_absolute_actions(task: NavigationTask, step_deg: int) -> WithAbsoluteValues:
    """The task with absolute headings or levels instead of its own actions."""
    if "level" in task.table.kinds:
        table = absolute_levels(task.aircraft, task.sector.levels_fl)
    else:
        table = absolute_headings(task.aircraft, step_deg)
    return WithAbsoluteValues(replace(task, table=table))


def with_large_changes(task: NavigationTask, sizes: range) -> NavigationTask:
    """The task with changes of several sizes: turns [deg] or climbs and descents [FL]."""
    if "level" in task.table.kinds:
        table = level_changes(task.aircraft, task.sector.levels_fl, tuple(sizes))
    else:
        table = turns(task.aircraft, tuple(sizes))
    return replace(task, table=table)
