"""BluebirdDT's Springfield: its fixed scenarios, flown in BluebirdDT, and as a timetable.

Everything is read from the installed BluebirdDT. Flights are born at fixed times and places, and
hear clearances from a fixed time on. Each has its own speeds and rates, which BluebirdDT draws with
a seed from the scenario.

Needs `bluebird-dt` (extra `[bluebird]`, AGPL).
"""

from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from skystack.airspace.sector import Sector
from skystack.airspace.sector_file import make_sector
from skystack.errors import requires_extra, unknown_name
from skystack.platforms.bluebird import sector_entry
from skystack.platforms.bluebird_traffic import QUIET, BluebirdTraffic
from skystack.platforms.flight_report import FlightReport
from skystack.simulator.sampled_performance import SampledPerformance
from skystack.simulator.timetable import ListedFlight

with requires_extra(__name__, "bluebird"):
    from bluebird_dt.scenario_manager.springfield import SpringfieldScenarioManager

AIRSPACE = "Springfield"
_LEVELS = 601
"""Performance is sampled at the flight levels from 0 to 600."""
_BORN_WITHIN_CYCLES = 600
"""All flights of a scenario are born within this number of cycles."""
_UNCONTROLLED = "background"
"""BluebirdDT's sector of flights that are not in contact."""


class _Scenarios(SpringfieldScenarioManager):  # type: ignore[misc]  # of a package without types
    """Springfield without two of its rules, which it applies before each cycle."""

    def update(self, env_manager: Any) -> Any:
        """Let flights that are cleared direct to a fix fly there and along their routes.

        Springfield ends the own navigation of all flights in contact, so that a clearance direct to
        a fix would last for one cycle.
        """
        env_manager = super().update(env_manager)
        for aircraft in env_manager.environment.aircraft.values():
            if _is_direct(aircraft):
                aircraft.on_route = True
        return env_manager

    def _check_aircraft_landing(self, *_: Any, **__: Any) -> list[str]:
        """Remove no flights: landings are decided by `skystack.airspace.landing`."""
        return []


def scenario_names() -> list[str]:
    """The names of Springfield's scenarios in the installed BluebirdDT."""
    return list(_Scenarios.list_scenarios())


class SpringfieldScenario(NamedTuple):
    """A scenario, as read from BluebirdDT."""

    sector: Sector
    performance: SampledPerformance
    """Its kinds are the flights, in order."""
    flights: tuple[ListedFlight, ...]
    """In order of birth."""


class SpringfieldTraffic(BluebirdTraffic):
    """Flies a scenario. It is the same for every seed."""

    def __init__(self, scenario: str) -> None:
        """Raises InputError if BluebirdDT has no scenario of this name."""
        super().__init__()
        if scenario not in scenario_names():
            raise unknown_name("Springfield scenario", scenario, scenario_names())
        self._scenario = scenario
        self._contact_s: dict[str, float] = {}
        self._start_s = 0.0
        self._kinds: dict[str, int] = {}

    def _set_up(self, seed: int) -> Any:
        simulator = _Scenarios.setup(self._scenario, **QUIET)
        self._kinds, self._start_s = {}, float(simulator.manager.environment.time)
        calls = simulator.manager.event_handler.incomm_df
        self._contact_s = {
            callsign: time.timestamp() - self._start_s
            for time, callsign in zip(calls.index, calls["callsign"], strict=True)
        }
        return simulator

    def _reports(self) -> dict[str, FlightReport]:
        environment, reports = self._simulator.manager.environment, {}
        for callsign, aircraft in environment.aircraft.items():
            if aircraft.current_sector != _UNCONTROLLED and not _is_direct(aircraft):
                aircraft.on_route = False  # as Springfield will, before it flies the next cycle
            kind = self._kinds.setdefault(callsign, len(self._kinds))
            if aircraft.speed_tas is None:  # not computed yet for a newborn
                self._simulator.manager.predictor.update_speeds(aircraft, None)
            reports[callsign] = self._report(environment, aircraft)._replace(
                kind=kind, contact_s=self._contact_s.get(callsign, 0.0)
            )
        return reports

    @property
    def is_complete(self) -> bool:
        """Whether all flights have been born."""
        return len(self._plans) == len(self._simulator.manager.event_handler.flight_df)

    def sampled(self, callsign: str) -> tuple[str, Float[np.ndarray, "2 3 levels"]]:
        """The type of a flight, and its airspeeds and vertical speeds at each level.

        The rows are climb, cruise and descent.
        """
        manager = self._simulator.manager
        probe = deepcopy(manager.environment.aircraft[callsign])
        samples = np.empty((2, 3, _LEVELS))
        for row, phase in enumerate((1, 0, -1)):
            for level in range(_LEVELS):
                probe.fl, probe.selected_fl = float(level), float(level + phase)
                manager.predictor.update_total_speeds(probe)
                manager.predictor.update_vertical_speeds(probe)
                samples[:, row, level] = probe.speed_tas, probe.vertical_speed
        return str(probe.aircraft_type), samples


def _is_direct(aircraft: Any) -> bool:
    """Whether a flight is cleared direct to a fix, and has not reached the end of its route."""
    last = aircraft.cleared_instructions.lateral_action
    return (
        last is not None and last.kind == "route_direct_to" and aircraft.next_fix_index is not None
    )


def read_scenario(name: str) -> SpringfieldScenario:
    """Read a scenario by flying it until all flights are born.

    Raises InputError if BluebirdDT has no scenario of this name.
    """
    traffic = SpringfieldTraffic(name)
    flights, types, samples = dict[str, ListedFlight](), [], []
    reports = traffic.reset(0)
    for cycle in range(_BORN_WITHIN_CYCLES):
        for callsign, report in reports.items():
            if callsign not in flights:
                flights[callsign] = _listed(callsign, report, cycle)
                aircraft_type, sampled = traffic.sampled(callsign)
                types.append(aircraft_type)
                samples.append(sampled)
        if traffic.is_complete:
            break
        reports = traffic.advance()
    traffic.close()
    speeds, rates = np.moveaxis(np.array(samples), 1, 0)
    performance = SampledPerformance(tuple(types), speeds, rates)
    sector = _with_routes([each.route for each in flights.values()])
    return SpringfieldScenario(sector, performance, tuple(flights.values()))


def _with_routes(routes: Sequence[tuple[str, ...]]) -> Sector:
    """Springfield with these routes too.

    Flights that start inside the sector have routes that it does not list.
    """
    entry = sector_entry(AIRSPACE)
    return make_sector(replace(entry, routes=tuple(dict.fromkeys((*entry.routes, *routes)))))


def _listed(callsign: str, report: FlightReport, cycle: int) -> ListedFlight:
    return ListedFlight(
        callsign=callsign,
        kind=report.kind,
        route=report.route,
        birth_cycle=cycle,
        contact_s=report.contact_s,
        lat=report.lat,
        lon=report.lon,
        heading_deg=report.heading_deg,
        fl=report.fl,
        cleared_fl=report.cleared_fl,
        exit_fl=report.exit_fl,
        own_navigation=report.own_navigation,
    )
