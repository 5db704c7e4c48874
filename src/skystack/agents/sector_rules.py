"""Simple rule-based controllers of a sector, as baselines."""

import numpy as np

from skystack.agents.transmission import PER_CYCLE, Transmission
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.sector_world import World, WorldState

AVOID_NM = 10.0
"""Flights closer than this, whose levels overlap, turn away from each other."""
AVOID_DEG = 40
RESUME_CYCLES = 10
"""A flight that has turned away holds its heading for at least this many cycles."""


class NoOp:
    """Never transmits."""

    def begin(self, state: WorldState) -> None:
        """Do nothing."""

    def transmit(self, state: WorldState) -> list[Transmission]:
        return []


class OwnNavigation:
    """Sends every new flight direct to its next fix, with or without its exit level."""

    def __init__(self, clears_exit_level: bool, per_cycle: int = PER_CYCLE) -> None:
        self.clears_exit_level, self.per_cycle = clears_exit_level, per_cycle
        self._served: set[int] = set()

    def begin(self, state: WorldState) -> None:
        self._served = set()

    def transmit(self, state: WorldState) -> list[Transmission]:
        flight = state.arrivals.flight
        hearing = np.flatnonzero(state.hears).tolist()
        new = [slot for slot in hearing if int(flight[slot]) not in self._served]
        new.sort(key=lambda slot: int(flight[slot]))
        chosen = new[: self.per_cycle]
        self._served |= {int(flight[slot]) for slot in chosen}
        return [resume(state, slot, self.clears_exit_level) for slot in chosen]


class Mvp(OwnNavigation):
    """Own navigation to the exit level, while BlueSky's conflict resolution (the modified voltage
    potential) manoeuvres the flights. Its manoeuvres are not transmissions."""


def resume(state: WorldState, slot: int, clears_exit_level: bool) -> Transmission:
    """Direct to the next fix, with the exit level if `clears_exit_level`."""
    level = float(state.plan.exit_level_ticks[slot])
    changes = clears_exit_level and level != float(state.traffic.cleared_level_ticks[slot])
    return Transmission(
        slot, fix=int(state.progress.next_fix[slot]), level_ticks=level if changes else None
    )


class Rules(OwnNavigation):
    """Own navigation to the exit level; a flight that is close to another turns away from it.

    The nearest pair turns first. A flight resumes own navigation when no other is close.
    """

    def __init__(self, world: World, per_cycle: int = PER_CYCLE) -> None:
        super().__init__(True, per_cycle)
        self._world = world
        self._turned: dict[int, int] = {}
        """The cycle in which each flight turned away."""

    def begin(self, state: WorldState) -> None:
        super().begin(state)
        self._turned = {}

    def transmit(self, state: WorldState) -> list[Transmission]:
        cycle, flight = int(state.arrivals.cycle), state.arrivals.flight
        distance_nm = self._distances_nm(state)
        wanted: list[Transmission] = []
        nearest = distance_nm.min(axis=1)
        for slot in np.argsort(nearest).tolist():
            number = int(flight[slot])
            if nearest[slot] >= AVOID_NM or number in self._turned or len(wanted) >= self.per_cycle:
                continue
            other = int(np.argmin(distance_nm[slot]))
            self._turned[number] = cycle
            self._served.add(number)
            wanted.append(Transmission(slot, heading_deg=self._away(state, slot, other)))
        for number, since in list(self._turned.items()):
            slots = np.flatnonzero(flight == number)
            if not len(slots):
                del self._turned[number]
                continue
            slot = int(slots[0])
            clear = nearest[slot] >= AVOID_NM and cycle - since >= RESUME_CYCLES
            if clear and len(wanted) < self.per_cycle:
                del self._turned[number]
                wanted.append(resume(state, slot, True))
        return wanted or super().transmit(state)

    def _distances_nm(self, state: WorldState) -> np.ndarray:
        """Distances between flights whose levels overlap; infinite between others."""
        traffic = state.traffic
        position = traffic.position_nm.astype(np.float64)
        offset = position[:, None] - position[None]
        scale = self._world.sector.plane.scale(position[:, 1])
        distance = np.hypot(offset[..., 0], offset[..., 1]) / np.asarray(scale)[:, None]
        margin = self._world.sector.separation_fl * TICKS_PER_FL
        low = np.minimum(traffic.level_ticks, traffic.cleared_level_ticks)
        high = np.maximum(traffic.level_ticks, traffic.cleared_level_ticks)
        overlap = (low[:, None] < high[None] + margin) & (low[None] < high[:, None] + margin)
        both = state.hears[:, None] & state.hears[None] & overlap
        both = both & ~np.eye(len(both), dtype=bool)
        return np.where(both, distance, np.inf)

    def _away(self, state: WorldState, slot: int, other: int) -> int:
        """The heading that turns a flight away from another."""
        east, north = state.traffic.position_nm[other] - state.traffic.position_nm[slot]
        bearing = np.degrees(np.arctan2(east, north))
        heading = float(state.traffic.heading_deg[slot])
        to_right = (bearing - heading + 180.0) % 360.0 - 180.0 > 0.0
        return round(heading + (-AVOID_DEG if to_right else AVOID_DEG)) % 360
