"""The memory of a task: everything it tracks in addition to the traffic.

The tracker uses only the traffic that a platform reports, so it works with any platform.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import Traffic
from skystack.tasks.instruction_counts import (
    InstructionCounts,
    begin_counts,
    count_cycle,
    count_instruction,
)
from skystack.tasks.progress import FlightPlan, Progress, ProgressTracker
from skystack.tasks.separation import (
    Separation,
    begin_separation,
    separation_nm,
    update_separation,
)


class Memory(NamedTuple):
    """The history of a scenario that the task needs."""

    plan: FlightPlan
    progress: Progress
    counts: InstructionCounts
    separation: Separation


@dataclass(frozen=True)
class Tracker:
    """Updates the memory of scenarios in one sector."""

    sector: Sector
    airway_nm: float | None = None
    """The distance from the centreline beyond which an aircraft has made an excursion."""

    @cached_property
    def progress(self) -> ProgressTracker:
        return ProgressTracker(self.sector, self.airway_nm)

    def begin(self, traffic: Traffic, exit_level_ticks: Float[Array, "aircraft *batch"]) -> Memory:
        """The memory at cycle 0."""
        return Memory(
            plan=FlightPlan(traffic.level_ticks, exit_level_ticks),
            progress=self.progress.begin(traffic),
            counts=begin_counts(traffic),
            separation=begin_separation(traffic),
        )

    def instruct(
        self,
        memory: Memory,
        instructed: Bool[Array, "aircraft *batch"],
        action: Int[Array, "*batch"],
    ) -> Memory:
        """Count an action. `instructed` is a mask of the instructed aircraft: one, or none."""
        return memory._replace(counts=count_instruction(memory.counts, instructed, action))

    def track(self, memory: Memory, traffic: Traffic) -> Memory:
        """The memory after a cycle. `traffic.active` is still as it was before the cycle."""
        last_nm = subroutine(partial(separation_nm, self.sector), memory.progress, traffic)
        return Memory(
            plan=memory.plan,
            progress=self.progress.update(memory.progress, memory.plan, traffic),
            counts=count_cycle(memory.counts),
            separation=update_separation(memory.separation, last_nm),
        )

    def close(self, memory: Memory, ended: Bool[Array, "*batch"]) -> Memory:
        """The memory with the final updates of the scenarios that have ended."""
        return memory._replace(progress=self.progress.close(memory.progress, ended))
