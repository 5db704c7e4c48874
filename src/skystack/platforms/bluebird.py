"""BluebirdDT, the simulator of the paper's authors, behind the platform protocol.

Needs `bluebird-dt` (extra `[bluebird]`, AGPL), which only the modules `bluebird*` of this package
import. Scenarios with the `table` performance fly its `LinearPredictor` at the speeds of its
tables, those with `constant` its `SimplePredictor` at 400 kt; skystack's models follow these two.
Types of a fleet fly the fleet's speeds and rates.

BluebirdDT's areas end at the 180th meridian, so it gets longitudes relative to the sector's origin.
Nothing else changes, since an ellipsoid of revolution is the same at every longitude.
"""

import json
import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skystack.airspace.projection import wrap_longitude
from skystack.airspace.sector import Sector as OurSector
from skystack.airspace.sector_file import Point, SectorEntry, make_sector
from skystack.errors import InputError, PlatformError, error_context, requires_extra, unknown_name
from skystack.platforms.adoption import BLUEBIRD
from skystack.platforms.instruction import Instruction
from skystack.platforms.languages import bluebird_actions
from skystack.platforms.protocol import Report, check_types, substitute_callsigns
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import TablePerformance
from skystack.simulator.scenario_file import Aircraft, Scenario
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import ticks

with requires_extra(__name__, "bluebird"):
    from bluebird_dt.airspace_generator.airspace_loader import AirspaceLoader
    from bluebird_dt.core import Airspace, Area, Fixes, Pos2D, Pos3D, Route, Sector, Volume
    from bluebird_dt.predictor import LinearPredictor, SimplePredictor
    from bluebird_dt.scenario_manager.custom import Custom
    from bluebird_dt.utility.paths import AIRCRAFT_WEIGHT_MAPPING_FILE

_FAR_NM = 10_000.0
"""Distance from its sector at which BluebirdDT removes an aircraft; its default is 20 NM."""
MAX_FL = 600
"""The highest level that a sector may have in skystack."""


class Bluebird:
    """Implements `skystack.platforms.protocol.Platform`; writes no files."""

    adoption = BLUEBIRD

    def __init__(self) -> None:
        silence()
        self._types = json.loads(Path(AIRCRAFT_WEIGHT_MAPPING_FILE).read_bytes())
        self._simulator: Any = None
        self._aircraft: list[Any] = []
        self._names: dict[str, str] = {}
        """BluebirdDT's names by callsign: it spells callsigns out and knows few characters."""
        self._origin_lon_deg = 0.0

    def reset(self, scenario: Scenario) -> Report:
        self.close()
        known = {*self._types, *(member.type for member in scenario.fleet)}
        allowed = f"the {len(self._types)} types of its weight map, such as B753, or of the fleet"
        check_types(scenario, known, "BluebirdDT", allowed)
        self._origin_lon_deg = scenario.sector.origin[1]
        self._names = substitute_callsigns(scenario)
        self._simulator = _simulator(scenario, self._names)
        stop_logging(self._simulator)
        manager = self._simulator.manager
        flying = manager.environment.aircraft
        self._aircraft = [flying[name] for name in self._names.values()]
        for aircraft, entry in zip(self._aircraft, scenario.aircraft, strict=True):
            aircraft.aircraft_type = entry.type
            # BluebirdDT may have rounded the level.
            aircraft.fl = aircraft.cleared_fl = aircraft.selected_fl = entry.fl
            if scenario.performance == "table":
                aircraft.selected_instructions.cas = None
            manager.predictor.update_speeds(aircraft, None)
        return self._report()

    def issue(self, instruction: Instruction) -> None:
        if instruction.level_fl is not None and instruction.level_fl % 10:
            raise InputError(
                f"level_fl is {instruction.level_fl} for {instruction.callsign} (allowed: "
                "multiples of 10, to which BluebirdDT rounds)"
            )
        act(self._simulator, self._names[instruction.callsign], instruction)

    def advance(self) -> Report:
        self._simulator.evolve(float(CYCLE_S))
        flying = self._simulator.manager.environment.aircraft
        lost = [callsign for callsign, name in self._names.items() if name not in flying]
        if lost:
            raise PlatformError(f"BluebirdDT has lost {', '.join(lost)}")
        self._aircraft = [flying[aircraft.callsign] for aircraft in self._aircraft]
        return self._report()

    def close(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None

    def _report(self) -> Report:
        def column(values: list[float]) -> np.ndarray:
            return np.array(values, dtype=np.float64)

        aircraft = self._aircraft
        selected = [each.selected_instructions for each in aircraft]
        return Report(
            lat=column([each.lat for each in aircraft]),
            lon=wrap_longitude(column([each.lon for each in aircraft]) + self._origin_lon_deg),
            fl=column([each.fl for each in aircraft]),
            heading_deg=column([each.heading for each in aircraft]),
            cleared_heading_deg=column([cleared_heading_deg(each) for each in aircraft]),
            cleared_fl=column([chosen.fl for chosen in selected]),
            ground_speed_kt=column([each.ground_speed or each.speed_tas for each in aircraft]),
            vertical_speed_ft_min=column([each.vertical_speed for each in aircraft]),
        )


def silence() -> None:
    """Keep BluebirdDT from printing warnings."""
    # Without a handler, Python's handler of last resort would print them to standard error.
    logger = logging.getLogger("bluebird_dt")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False


def stop_logging(simulator: Any) -> None:
    """Keep BluebirdDT from recording every cycle: skystack has recordings of its own.

    BluebirdDT reads its records only to write files and for its own radar display. With many
    flights, recording takes a quarter of its time.
    """
    logger = simulator.manager.event_logger
    logger.log_environment = logger.log_clearances = lambda *_, **__: None


def act(simulator: Any, callsign: str, instruction: Instruction) -> None:
    """Instruct the aircraft with this callsign in BluebirdDT.

    Raises PlatformError if BluebirdDT refuses.
    """
    accepted = simulator.action(
        [
            {"callsign": callsign, "kind": kind, "value": value, "agent": "skystack"}
            for kind, value in bluebird_actions(instruction)
        ]
    )
    if not accepted:
        raise PlatformError(f"BluebirdDT refused {instruction}")


def cleared_heading_deg(aircraft: Any) -> float:
    """The cleared heading; on own navigation the actual one.

    An aircraft whose own navigation has ended may still be turning to the last fix.
    """
    cleared = None if aircraft.on_route else aircraft.selected_instructions.heading
    if cleared is None and not aircraft.on_route:
        cleared = aircraft.heading_changing_to
    return float(aircraft.heading if cleared is None else cleared)


def _simulator(scenario: Scenario, names: Mapping[str, str]) -> Any:
    """BluebirdDT's simulator with a scenario's sector and aircraft, at its start."""
    manager = Custom(
        num_aircraft=0,
        airspace=_airspace(scenario),
        routes=[],
        lateral_buffer_distance=_FAR_NM,
        vertical_buffer_distance=_FAR_NM,
    )
    start = scenario.initial_traffic(scenario.simulator())
    for aircraft, speed_kt in zip(scenario.aircraft, start.ground_speed_kt.tolist(), strict=True):
        _add(manager, names[aircraft.callsign], aircraft, scenario.sector, speed_kt)
    return manager.to_simulator(
        scenario_name="skystack",
        predictor=_predictor(scenario),
        attach_context_to_logger=False,
        save_log_to_file=False,
        autosave_interval=None,
        log_filename="skystack",
    )


def _predictor(scenario: Scenario) -> Any:
    """A predictor with BluebirdDT's settings: one-second steps, fixes reached at 2 or 0.5 NM."""
    if scenario.performance != "table":
        return SimplePredictor(1.0, 2.0)
    return _FleetPredictor(scenario.fleet) if scenario.fleet else LinearPredictor(1.0, 0.5)


class _FleetPredictor(LinearPredictor):  # type: ignore[misc]  # of a package without types
    """BluebirdDT's motion with the speeds and rates of a fleet's types."""

    def __init__(self, fleet: tuple[AircraftType, ...]) -> None:
        super().__init__(1.0, 0.5)
        self._tables: dict[str, TablePerformance] = {each.type: each.table() for each in fleet}

    def update_total_speeds(self, aircraft: Any) -> None:
        speeds = self._tables[aircraft.aircraft_type].airspeeds_kt[1 - _phase(aircraft)]
        aircraft.speed_tas = float(np.interp(aircraft.fl, np.arange(len(speeds)), speeds))

    def update_vertical_speeds(self, aircraft: Any) -> None:
        table, phase = self._tables[aircraft.aircraft_type], _phase(aircraft)
        # In whole ticks, as in skystack: BluebirdDT accumulates levels in floating point.
        at_ceiling = phase > 0 and ticks(aircraft.fl) >= ticks(table.ceiling_fl)
        aircraft.vertical_speed = 0.0 if at_ceiling else phase * table.rate_ft_min


def _phase(aircraft: Any) -> int:
    """1 in a climb, 0 in cruise, -1 in a descent."""
    return int(np.sign(aircraft.selected_fl - aircraft.fl))


def _place(sector: OurSector, lat: float, lon: float) -> tuple[float, float]:
    """A position for BluebirdDT, with the longitude relative to the sector's origin."""
    return lat, float(wrap_longitude(lon - sector.origin[1]))


def _add(manager: Any, name: str, aircraft: Aircraft, sector: OurSector, speed_kt: float) -> None:
    manager.add_aircraft_with_coordinations(
        aircraft_start_time=0.0,
        callsign=name,
        pos=Pos3D(*_place(sector, aircraft.lat, aircraft.lon), aircraft.fl),
        heading=aircraft.heading_deg,
        speed=speed_kt,
        route=Route(filed=list(aircraft.route)),
        entry_fl=aircraft.fl,
        exit_fl=float(aircraft.exit_fl),
        on_route=aircraft.own_navigation,
    )


def _airspace(scenario: Scenario) -> Any:
    """The scenario's sector as BluebirdDT's airspace."""
    sector = scenario.sector
    area = Area([Pos2D(*_place(sector, *corner)) for corner in sector.area])
    volume = Volume(area, *sector.levels_fl)
    fixes = Fixes({name: Pos2D(*_place(sector, *at)) for name, at in sector.fixes.items()})
    return Airspace({sector.name: Sector([volume])}, fixes)


def sector_named(name: str) -> OurSector:
    """A sector of the installed BluebirdDT: area, levels, fixes and routes.

    Raises InputError for an unknown name, and for an airspace with several volumes or with routes
    that do not lead through one area.
    """
    entry = sector_entry(name)
    with error_context(f"BluebirdDT's {name}"):
        return make_sector(entry)


def sector_entry(name: str) -> SectorEntry:
    """A sector of the installed BluebirdDT as a sector file would describe it, not yet checked."""
    if name not in AirspaceLoader.list_airspaces():
        raise unknown_name("sector of BluebirdDT", name, AirspaceLoader.list_airspaces())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # from shapely
        airspace, routes, sector_name = AirspaceLoader.load(name)
    volumes = airspace.sectors[sector_name].volumes
    with error_context(f"BluebirdDT's {name}"):
        if len(volumes) != 1:
            raise InputError(f"has {len(volumes)} volumes (allowed: 1)")
        corners = [(at.lon, at.lat) for at in volumes[0].area.boundary_vertices]
        fixes = {fix: Point(at.lat, at.lon) for fix, at in airspace.fixes.places.items()}
        return SectorEntry(
            name=f"bluebird:{name}",
            levels_fl=(int(volumes[0].min_fl), min(int(volumes[0].max_fl), MAX_FL)),
            area={"type": "Polygon", "coordinates": [corners]},
            fixes=fixes,
            # Springfield lists some routes twice.
            routes=tuple(dict.fromkeys(tuple(route.filed) for route in routes)),
        )
