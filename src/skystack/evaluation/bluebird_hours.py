"""Hours of BluebirdDT's own traffic, flown in BluebirdDT, for agents of sector control.

The state that agents see is rebuilt from BluebirdDT's reports after every cycle. Exits,
excursions and losses of separation are determined as in our simulator.
"""

import numpy as np
from jaxtyping import Bool

from skystack.agents.transmission import Transmission
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.errors import InputError
from skystack.evaluation.foreign_hours import ReportedTraffic, instructions_of, writable
from skystack.learning.seeds import scenario_key
from skystack.platforms.bluebird_traffic import BluebirdTraffic
from skystack.platforms.flight_report import FlightReport
from skystack.simulator.arrivals import FREE, Arrivals
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World, WorldCycle, WorldState


class BluebirdHours:
    """Implements `skystack.evaluation.hours.Hours` in BluebirdDT.

    `world` has BluebirdDT's sector and performance, and the number of slots.
    """

    def __init__(self, world: World, platform: BluebirdTraffic) -> None:
        self.world, self.platform = world, platform
        self._empty = shared_program(World(world.flow.without_starters()).reset)
        self._begin = shared_program(world.tracker.begin)
        self._end_cycle = shared_program(world.end_cycle)
        self._reports = ReportedTraffic(world)
        self._slot: dict[str, int] = {}
        """The slots of the flights that have not left, by callsign."""
        self._left: set[str] = set()
        """Flights that have left, which BluebirdDT may still report."""

    def reset(self, seed: int, number: int) -> WorldState:
        empty: WorldState = fetched(self._empty(scenario_key(seed, number)))
        self._slot, self._left = {}, set()
        reports = self.platform.reset(_random_seed(seed, number))
        arrivals, _ = self._admit(empty.arrivals, reports)
        traffic = self._reports.read(empty.traffic, self._slot, reports)
        return WorldState(traffic, arrivals, fetched(self._begin(traffic)))

    def advance(
        self, state: WorldState, transmissions: list[Transmission]
    ) -> tuple[WorldState, WorldCycle]:
        for each in instructions_of(self.world, state.traffic, self._slot, transmissions):
            self.platform.issue(each)
        reports = {
            callsign: report
            for callsign, report in self.platform.advance().items()
            if callsign not in self._left
        }
        arrivals, born = self._admit(state.arrivals, reports)
        arrivals = arrivals._replace(cycle=arrivals.cycle + 1)
        flown = self._reports.read(state.traffic, self._slot, reports)
        removed = np.zeros_like(born)
        removed[[slot for callsign, slot in self._slot.items() if callsign not in reports]] = True
        next_state, cycle = fetched(
            self._end_cycle(state.progress, flown, born, arrivals, flown, removed)
        )
        gone = {
            callsign for callsign, slot in self._slot.items() if not next_state.traffic.active[slot]
        }
        self._left |= gone
        self._slot = {name: slot for name, slot in self._slot.items() if name not in gone}
        return next_state, cycle

    def close(self) -> None:
        self.platform.close()

    def _admit(
        self, arrivals: Arrivals, reports: dict[str, FlightReport]
    ) -> tuple[Arrivals, Bool[np.ndarray, " slots"]]:
        """Give slots to the flights that are reported for the first time."""
        values = writable(arrivals)
        flight, number = values["flight"], int(arrivals.born)
        born = np.zeros(len(flight), dtype=bool)
        for callsign, report in reports.items():
            if callsign in self._slot:
                continue
            free = np.flatnonzero(flight == FREE)
            if not len(free):
                raise InputError(f"BluebirdDT has more than {len(flight)} flights at once")
            slot = int(free[0])
            self._slot[callsign], flight[slot], born[slot] = slot, number, True
            values["candidate"][slot] = number
            values["entry_level_ticks"][slot] = ticks(report.entry_fl)
            values["exit_level_ticks"][slot] = ticks(report.exit_fl)
            if values["contact_s"] is not None:
                values["contact_s"][slot] = report.contact_s
            number += 1
        values["held"][:] = 0
        for callsign, slot in self._slot.items():
            values["held"][slot] = callsign in reports and reports[callsign].held
        return Arrivals(**values | {"born": np.int32(number)}), born


def _random_seed(seed: int, number: int) -> int:
    """BluebirdDT's random seed for an hour."""
    return int(np.random.SeedSequence((seed, number)).generate_state(1)[0])
