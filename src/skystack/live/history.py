"""What has happened in a live hour, as updates for pages.

A page that has the first k updates needs only those after them, so pages may join late, fall behind
or lose their connection. Updates are values for JSON; flights are numbered in order of birth.
"""

import secrets
from collections.abc import Mapping
from typing import Any

import numpy as np

from skystack.agents.transmission import Transmission
from skystack.airspace.sector import Sector
from skystack.evaluation.followed import status_of
from skystack.evaluation.losses import compiled_squared_nm2
from skystack.evaluation.tables import clearance_rows
from skystack.platforms.instruction import Instruction
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import Simulator
from skystack.tasks.sector_world import WorldCycle, WorldState

ROUNDED = {"nm": 4, "fl": 3, "deg": 2, "kt": 1, "ft_min": 1}
"""The decimals of values in updates."""


class History:
    """The updates of one hour, from its start."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.epoch = secrets.randbelow(2**40)
        """Identifies the updates. It changes when some are taken back; pages then begin again."""
        self.updates: list[dict[str, Any]] = []
        self._born = 0

    @property
    def sector(self) -> Sector:
        return self._simulator.sector

    def add_start(self, state: WorldState, slots: Mapping[str, int]) -> None:
        """Add the flights that are there before the first cycle, if any."""
        if not slots:
            return
        traffic = state.traffic
        none: Any = np.zeros(len(state.arrivals.flight), dtype=bool)
        start = WorldCycle(
            flight=state.arrivals.flight,
            before_nm=traffic.position_nm,
            before_level_ticks=traffic.level_ticks,
            traffic=traffic,
            born=none,
            entered=state.progress.entered,
            exited=none,
            exited_correctly=none,
            excursion=none,
            exit_level_ticks=state.arrivals.exit_level_ticks,
            waiting=state.arrivals.waiting,
        )
        self._add(0, start, slots, losses=[])

    def add_cycle(self, number: int, cycle: WorldCycle, slots: Mapping[str, int]) -> None:
        """Add a cycle that was flown, and the slots of all flights by callsign."""
        self._add(number, cycle, slots, self._losses(cycle))

    def _add(
        self,
        number: int,
        cycle: WorldCycle,
        slots: Mapping[str, int],
        losses: list[list[float]],
    ) -> None:
        callsign = {slot: name for name, slot in slots.items()}
        flying = np.flatnonzero(cycle.flight != FREE)
        flying = flying[np.argsort(cycle.flight[flying])]
        newborn = flying[cycle.flight[flying] >= self._born].tolist()
        self._born += len(newborn)
        self.updates.append(
            {
                "cycle": number,
                "born": [self._begun(cycle, slot, callsign[slot]) for slot in newborn],
                "flights": _rows(cycle, flying),
                "gone": _gone(cycle, flying),
                "losses": losses,
            }
        )

    def add_clearance(
        self,
        state: WorldState,
        transmission: Transmission,
        issued: Instruction,
        by: str,
    ) -> None:
        """Add a transmission by somebody; `state` is that after it."""
        slot, traffic = transmission.slot, state.traffic
        route = self.sector.routes[int(traffic.route[slot])]
        rows = clearance_rows(int(state.arrivals.cycle), issued, route, transmission.instructions)
        self.updates.append(
            {
                "aircraft": int(state.arrivals.flight[slot]),
                "cleared_heading": _number(traffic.cleared_heading_deg[slot], "deg"),
                "cleared_fl": _number(traffic.cleared_level_ticks[slot] / TICKS_PER_FL, "fl"),
                "by": by,
                "clearances": [
                    {name: value for name, value in row.items() if name != "callsign"}
                    for row in rows
                ],
            }
        )

    def rewind(self, cycle: int) -> None:
        """Remove all updates after a cycle and begin a new epoch, so that pages start over."""
        kept: list[dict[str, Any]] = []
        for update in self.updates:
            if update.get("cycle", 0) > cycle or _issued_in(update) >= cycle:
                break
            kept.append(update)
        self.updates, self.epoch = kept, self.epoch + 1
        self._born = sum(len(update.get("born", ())) for update in kept)

    def _begun(self, cycle: WorldCycle, slot: int, callsign: str) -> dict[str, Any]:
        """What is known of a flight from its birth on."""
        traffic = cycle.traffic
        return {
            "callsign": callsign,
            "type": self._simulator.performance.types[int(traffic.kind[slot])],
            "route": self.sector.routes[int(traffic.route[slot])],
            "entry_fl": _number(cycle.before_level_ticks[slot] / TICKS_PER_FL, "fl"),
            "exit_fl": round(float(cycle.exit_level_ticks[slot]) / TICKS_PER_FL),
        }

    def _losses(self, cycle: WorldCycle) -> list[list[float]]:
        """The pairs that were not separated in a cycle, with their least distance."""
        squared_nm2 = compiled_squared_nm2(self.sector.plane, self.sector.separation_fl)
        here = cycle.flight != FREE
        before, after = (
            np.where(here[:, None], values, np.nan).astype(np.float32)
            for values in (cycle.before_nm, cycle.traffic.position_nm)
        )
        levels = (
            np.where(here, values, np.nan).astype(np.float32)
            for values in (cycle.before_level_ticks, cycle.traffic.level_ticks)
        )
        distance = np.sqrt(np.asarray(squared_nm2(before, after, *levels)))
        pairs = np.flatnonzero(distance < self.sector.loss_below_nm)
        first, second = (each[pairs] for each in np.triu_indices(len(here), k=1))
        return [
            [*sorted((int(cycle.flight[one]), int(cycle.flight[other]))), round(float(nm), 3)]
            for one, other, nm in zip(first, second, distance[pairs], strict=True)
        ]


def _issued_in(update: dict[str, Any]) -> int:
    """The number of cycles flown when a clearance was issued; -1 for an update that is a cycle."""
    clearances = update.get("clearances", ())
    return clearances[0]["cycle"] if clearances else -1


def _gone(cycle: WorldCycle, slots: np.ndarray) -> list[list[Any]]:
    """The flights that leave, each with how: `correct`, `wrong_exit_level` or `excursion`."""
    found: list[list[Any]] = []
    for slot in slots.tolist():
        flight = int(cycle.flight[slot])
        if cycle.exited[slot]:
            found.append(
                [flight, "correct" if cycle.exited_correctly[slot] else "wrong_exit_level"]
            )
        elif cycle.excursion[slot]:
            found.append([flight, "excursion"])
    return found


def _rows(cycle: WorldCycle, slots: np.ndarray) -> list[list[float]]:
    """One row per flight: number, position, level, headings, cleared level, speeds, and status."""
    traffic = cycle.traffic
    status = status_of(cycle.entered, cycle.exited, cycle.excursion)
    columns = (
        (cycle.flight, None),
        (traffic.position_nm[:, 0], "nm"),
        (traffic.position_nm[:, 1], "nm"),
        (traffic.level_ticks / TICKS_PER_FL, "fl"),
        (traffic.heading_deg, "deg"),
        (traffic.cleared_heading_deg, "deg"),
        (traffic.cleared_level_ticks / TICKS_PER_FL, "fl"),
        (traffic.ground_speed_kt, "kt"),
        (traffic.vertical_speed_ft_min, "ft_min"),
        (status, None),
    )
    values = [
        np.asarray(column)[slots].tolist()
        if unit is None
        else np.round(np.asarray(column, dtype=np.float64)[slots], ROUNDED[unit]).tolist()
        for column, unit in columns
    ]
    return [list(row) for row in zip(*values, strict=True)]


def _number(value: Any, unit: str) -> float:
    return round(float(value), ROUNDED[unit])
