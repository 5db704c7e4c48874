"""Trial plans for one flight: a few clearances to fixes, headings and levels."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skystack.agents.transmission import Transmission
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World, WorldState

TURNS_DEG = (-60, -45, -30, -20, -10, 10, 20, 30, 45, 60)
HOLDS = (4, 7, 10, 15, 20, 30, 40)
"""Cycles for which a heading is held."""
WAITS = (0, 2, 4, 7, 10)
"""Cycles before the first clearance."""
LEVEL_WAITS = (5, 10, 15, 20, 30, 40, 50, 60, 75, 90, 110, 130)
"""Cycles before the clearance to the exit level."""
FIXES_AHEAD = 4
"""The number of fixes of the route, from the next one on, to which a flight may be sent."""
STEP_FL, BEYOND_FL = 10, 50
"""The spacing of intermediate levels, and how far they may lie beyond cleared and exit levels."""


class Step(NamedTuple):
    """A planned clearance: what is cleared, after so many cycles."""

    wait: int
    fix: int | None = None
    turn_deg: int | None = None
    """A turn from the present heading."""
    level_ticks: float | None = None

    def transmission(self, slot: int, heading_deg: float) -> Transmission:
        """The clearance for the flight in a slot, whose present heading is given."""
        turned = None if self.turn_deg is None else round(heading_deg + self.turn_deg) % 360
        return Transmission(slot, turned, self.fix, self.level_ticks)


Plan = tuple[Step, ...]


@dataclass(frozen=True)
class Trials:
    """Trial plans for a flight."""

    random: np.random.Generator
    exit_level_ticks: float
    needs_exit_level: bool
    """Whether the flight is not yet cleared to its exit level."""
    own: bool
    """Whether it is on own navigation."""
    fixes: tuple[int, ...]
    levels: tuple[float, ...]
    """Intermediate levels, in ticks."""

    @classmethod
    def of(
        cls, state: WorldState, slot: int, world: World, random: np.random.Generator
    ) -> "Trials":
        """The trial plans for the flight in a slot."""
        route = int(state.traffic.route[slot])
        last = int(world.sector.route_table.last_fix[route])
        next_fix = int(state.progress.next_fix[slot])
        cleared = float(state.traffic.cleared_level_ticks[slot])
        exit_level_ticks = float(state.plan.exit_level_ticks[slot])
        lowest, highest = (ticks(float(fl)) for fl in world.sector.levels_fl)
        low = max(lowest, min(exit_level_ticks, cleared) - ticks(BEYOND_FL))
        high = min(highest, max(exit_level_ticks, cleared) + ticks(BEYOND_FL))
        levels = np.arange(low, high + 1.0, ticks(STEP_FL))
        return cls(
            random,
            exit_level_ticks,
            exit_level_ticks != cleared,
            bool(state.traffic.own_navigation[slot]),
            tuple(range(next_fix, min(next_fix + FIXES_AHEAD, last + 1))),
            tuple(float(level) for level in levels if level != exit_level_ticks),
        )

    @property
    def level_to_clear(self) -> float | None:
        """The exit level, if it is still to be cleared."""
        return self.exit_level_ticks if self.needs_exit_level else None

    def simple(self) -> Iterator[Plan]:
        """All plans with at most one transmission."""
        if self.own and not self.needs_exit_level:
            yield ()
        if self.own and self.needs_exit_level:
            for wait in (0, *LEVEL_WAITS):
                yield (Step(wait, level_ticks=self.exit_level_ticks),)
        for fix in self.fixes:
            for wait in WAITS:
                yield (Step(wait, fix, level_ticks=self.level_to_clear),)

    def two(self) -> Plan:
        """A random plan with two transmissions."""
        if self.random.random() < 0.5:  # two levels
            first = None if self.needs_exit_level and self.random.random() < 0.3 else self._level()
            wait = self._one(WAITS)
            fix = None if self.own and first is not None else self._one(self.fixes)
            later = wait + self._one(LEVEL_WAITS)
            return Step(wait, fix, level_ticks=first), Step(
                later, level_ticks=self.exit_level_ticks
            )
        turn, hold = self._one(TURNS_DEG), self._one(HOLDS)
        fix, chance = self._one(self.fixes), self.random.random()
        wait = self._one((0, 0, 3, 8, 15))
        if not self.needs_exit_level or chance < 0.3:
            return Step(wait, None, turn, self.level_to_clear), Step(wait + hold, fix)
        first = None if chance < 0.6 else self._level()
        return Step(wait, None, turn, first), Step(
            wait + hold, fix, level_ticks=self.exit_level_ticks
        )

    def three(self) -> Plan:
        """A random plan with three transmissions."""
        wait, hold = self._one((0, 0, 3, 8, 15)), self._one(HOLDS)
        turn, fix = self._one(TURNS_DEG), self._one(self.fixes)
        first, later = self._level(), self._one(LEVEL_WAITS)
        if self.random.random() < 0.6:
            return (
                Step(wait, None, turn, first),
                Step(wait + hold, fix),
                Step(wait + hold + later, level_ticks=self.exit_level_ticks),
            )
        second = self._one(LEVEL_WAITS)
        return (
            Step(wait, fix, level_ticks=first),
            Step(wait + second, level_ticks=self._level()),
            Step(wait + second + later, level_ticks=self.exit_level_ticks),
        )

    def _one(self, values: tuple[int, ...]) -> int:
        return values[int(self.random.integers(len(values)))]

    def _level(self) -> float:
        return self.levels[int(self.random.integers(len(self.levels)))]
