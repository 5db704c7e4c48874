"""The world of sector control: flights arrive, fly through the sector and leave.

    reset(key) -> state
    instruct(state, clearance) -> state      changes what flights are cleared to; no time passes
    advance(state) -> (state, cycle)         one radar cycle: births, flight, exits

A flight leaves when it crosses its exit, when it leaves the area elsewhere, or when it strays
far away (`FAR_NM`) without having entered it. Its slot is then free.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.arrival_flows import Flow
from skystack.simulator.arrivals import FREE, Arrivals, release
from skystack.simulator.simulator import Simulator, instruct
from skystack.simulator.traffic import Clearance, Traffic, where_aircraft
from skystack.tasks.outlook import (
    MARGIN_NM,
    Outlook,
    look_ahead,
    look_ahead_for,
    time_to_loss_as_cleared,
)
from skystack.tasks.progress import FlightPlan, Progress, ProgressTracker

FAR_NM = 20.0
"""A flight that has not entered the area has left if it is this far outside the bounding box of the
area and the fixes."""


class WorldState(NamedTuple):
    """The traffic, its arrivals, and the progress of the flight in each slot."""

    traffic: Traffic
    arrivals: Arrivals
    progress: Progress

    @property
    def plan(self) -> FlightPlan:
        """The entry and exit level of the flight in each slot."""
        return FlightPlan(self.arrivals.entry_level_ticks, self.arrivals.exit_level_ticks)

    @property
    def hears(self) -> Any:
        """Whether there is a flight in each slot that hears clearances.

        `[slots, *batch]`, in numpy if the state is.
        """
        return self.traffic.active & self.arrivals.in_contact


class WorldCycle(NamedTuple):
    """What happened in a cycle, `[slots, *batch]`."""

    flight: Int[Array, "slots *batch"]
    """The flight in each slot during the cycle, or FREE."""
    before_nm: Float[Array, "slots 2 *batch"]
    """Positions before the cycle; where a flight was born in it, its position of birth."""
    before_level_ticks: Float[Array, "slots *batch"]
    traffic: Traffic
    """The traffic after the cycle, with the flights that leave."""
    born: Bool[Array, "slots *batch"]
    """Whether the flight was born in this cycle."""
    entered: Bool[Array, "slots *batch"]
    """Whether the flight has been inside the sector."""
    exited: Bool[Array, "slots *batch"]
    """Whether it leaves through its exit."""
    exited_correctly: Bool[Array, "slots *batch"]
    """Whether it leaves through its exit and at its exit level."""
    excursion: Bool[Array, "slots *batch"]
    """Whether it leaves elsewhere, or has strayed without having entered."""
    exit_level_ticks: Float[Array, "slots *batch"]
    waiting: Int[Array, "*batch"]
    """The number of flights that wait to enter."""


@dataclass(frozen=True)
class World:
    """Simulates flights that arrive in a sector, fly through it and leave."""

    flow: Flow

    @property
    def simulator(self) -> Simulator:
        return self.flow.simulator

    @property
    def sector(self) -> Sector:
        return self.simulator.sector

    @cached_property
    def tracker(self) -> ProgressTracker:
        return ProgressTracker(self.sector)

    def reset(self, key: PRNGKeyArray) -> WorldState:
        """The state at cycle 0."""
        arrivals, traffic = self.flow.draw(key)
        return WorldState(traffic, arrivals, self.tracker.begin(traffic))

    def instruct(self, state: WorldState, clearance: Clearance) -> WorldState:
        """Issue clearances. Newborns that are still held do not hear them."""
        traffic = instruct(state.traffic._replace(active=state.hears), clearance)
        return state._replace(traffic=traffic._replace(active=state.traffic.active))

    def look_ahead(
        self,
        state: WorldState,
        margin_nm: float = MARGIN_NM,
        flights: Bool[Array, "slots *batch"] | None = None,
        before: Outlook | None = None,
    ) -> Outlook:
        """The outlook of all flights, or of some; see `skystack.tasks.outlook.look_ahead`."""
        return look_ahead(self.simulator, *self._looks(state), margin_nm, flights, before)

    def look_ahead_for(self, state: WorldState, slot: Int[Array, ""]) -> Outlook:
        """The outlook of one flight; see `skystack.tasks.outlook.look_ahead_for`."""
        return look_ahead_for(self.simulator, slot, *self._looks(state))

    def time_to_loss_as_cleared(
        self, state: WorldState, margin_nm: float = MARGIN_NM
    ) -> Float[Array, "slots *batch"]:
        """The time until each flight would lose separation without a further clearance.

        In seconds, at most `HORIZON_S`; see `skystack.tasks.outlook.time_to_loss_as_cleared`.
        """
        return time_to_loss_as_cleared(self.simulator, *self._looks(state), margin_nm)

    def _looks(self, state: WorldState) -> tuple[Traffic, Any, Any, Any]:
        """What an outlook needs: the traffic, next fixes, exit levels, and who has entered."""
        progress = state.progress
        return state.traffic, progress.next_fix, state.plan.exit_level_ticks, progress.entered

    def advance(self, state: WorldState) -> tuple[WorldState, WorldCycle]:
        """One cycle. Flights that are due are admitted before it is flown."""
        begun, born, arrivals, flown = self.fly(state.arrivals, state.traffic)
        return self.end_cycle(state.progress, begun, born, arrivals, flown)

    def fly(
        self, arrivals: Arrivals, traffic: Traffic
    ) -> tuple[Traffic, Bool[Array, "slots *batch"], Arrivals, Traffic]:
        """Admit the flights that are due, and fly a cycle; nobody leaves.

        Returns the traffic before the cycle with the newborns, which flights these are, and the
        arrivals and the traffic after the cycle.
        """
        arrivals, begun, born = self.admit(arrivals, traffic)
        return begun, born, *self.flow.fly(arrivals, begun)

    def admit(
        self, arrivals: Arrivals, traffic: Traffic
    ) -> tuple[Arrivals, Traffic, Bool[Array, "slots *batch"]]:
        """Admit the flights that are due before the next cycle; returns also which these are."""
        before = arrivals.flight
        arrivals, begun = self.flow.admission.admit(arrivals, traffic)
        return arrivals, begun, (arrivals.flight != before) & (arrivals.flight != FREE)

    def end_cycle(
        self,
        progress: Progress,
        begun: Traffic,
        born: Bool[Array, "slots *batch"],
        arrivals: Arrivals,
        flown: Traffic,
        removed: Bool[Array, "slots *batch"] | None = None,
    ) -> tuple[WorldState, WorldCycle]:
        """Update the progress of flights after a cycle, and release those that left.

        The cycle may have been flown by another simulator. `progress` is from before the cycle;
        `arrivals` and `flown` are from after it. `begun` has the flights `born` in the cycle, as
        they begin. `removed` marks flights that the other simulator has removed: excursions.
        """
        progress = self._begin(progress, begun, born)
        before_nm, before_level_ticks = progress.previous_nm, progress.previous_level_ticks
        plan = FlightPlan(arrivals.entry_level_ticks, arrivals.exit_level_ticks)
        progress = subroutine(self.tracker.update, progress, plan, flown)
        excursion = makes_excursion(self.sector, progress, flown)
        excursion = flown.active & (excursion if removed is None else excursion | removed)
        exited = progress.exited & flown.active
        cycle = WorldCycle(
            flight=arrivals.flight,
            before_nm=before_nm,
            before_level_ticks=before_level_ticks,
            traffic=flown,
            born=born,
            entered=progress.entered,
            exited=exited,
            exited_correctly=progress.exited_correctly & flown.active,
            excursion=excursion,
            exit_level_ticks=arrivals.exit_level_ticks,
            waiting=arrivals.waiting,
        )
        arrivals, left = release(arrivals, flown, exited | excursion)
        return WorldState(left, arrivals, progress), cycle

    def _begin(
        self, progress: Progress, traffic: Traffic, born: Bool[Array, "slots *batch"]
    ) -> Progress:
        """The progress, begun afresh for newborn flights."""
        fresh = self.tracker.begin(traffic)
        # All fields but the last are per aircraft; the last is the number of cycles flown.
        return Progress(*where_aircraft(born, fresh[:-1], progress[:-1]), cycles=progress.cycles)


def is_far(sector: Sector, traffic: Traffic) -> Bool[Array, "flights *batch"]:
    """Whether flights are farther outside the area than `FAR_NM`."""
    points = np.stack([*sector.area_nm, *sector.fixes_nm.values()])
    # The scale of the plane hardly changes across a sector, so the box is in plane units.
    low, high = points.min(axis=0) - FAR_NM, points.max(axis=0) + FAR_NM
    east, north = traffic.position_nm[:, 0], traffic.position_nm[:, 1]
    inside = (east >= low[0]) & (east <= high[0]) & (north >= low[1]) & (north <= high[1])
    return ~inside


def makes_excursion(
    sector: Sector, progress: Progress, traffic: Traffic
) -> Bool[Array, "flights *batch"]:
    """Whether flights have left the area other than through their exits, or are far outside it
    without having entered it."""
    return progress.excursion | (~progress.entered & is_far(sector, traffic))
