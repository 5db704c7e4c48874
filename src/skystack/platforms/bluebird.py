"""BluebirdDT, the digital twin of the paper's authors, behind the platform protocol.

Needs `bluebird-dt` (the extra `[bluebird]`, AGPL); this module alone imports it. Scenarios of the
`table` performance fly its `LinearPredictor` at the speeds of its tables, those of `constant` its
`SimplePredictor` at 400 kt: the models that ours were made from. A fleet flies at its own speeds.
"""

import json
import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from bluebird_dt.airspace_generator.airspace_loader import AirspaceLoader
from bluebird_dt.core import Airspace, Area, Fixes, Pos2D, Pos3D, Route, Sector, Volume
from bluebird_dt.predictor import LinearPredictor, SimplePredictor
from bluebird_dt.scenario_manager.custom import Custom
from bluebird_dt.utility.paths import AIRCRAFT_WEIGHT_MAPPING_FILE

from skystack.airspace.sector import Sector as OurSector
from skystack.airspace.sector_file import Point, SectorEntry, make_sector
from skystack.errors import InputError, PlatformError, unknown_name
from skystack.json_file import inside
from skystack.platforms.instruction import NEXT_CYCLE, Instruction
from skystack.platforms.languages import bluebird_actions
from skystack.platforms.protocol import Report, check_types
from skystack.simulator.performance import TablePerformance
from skystack.simulator.scenario_file import Aircraft, Scenario
from skystack.simulator.simulator import CYCLE_S

_FAR_NM = 10_000.0
"""How far from its sector BluebirdDT keeps an aircraft; by default it removes it 20 NM outside."""


class Bluebird:
    """Implements `skystack.platforms.protocol.Platform`; writes no files at all."""

    adoption = NEXT_CYCLE

    def __init__(self) -> None:
        # Its warnings would reach standard error by Python's handler of last resort.
        logger = logging.getLogger("bluebird_dt")
        logger.addHandler(logging.NullHandler())
        logger.propagate = False
        self._types = json.loads(Path(AIRCRAFT_WEIGHT_MAPPING_FILE).read_bytes())
        self._simulator: Any = None
        self._aircraft: list[Any] = []

    def reset(self, scenario: Scenario) -> Report:
        self.close()
        allowed = f"one of the {len(self._types)} types of its weight map, as B753"
        check_types(scenario, self._types, "BluebirdDT", allowed)
        self._simulator = _simulator(scenario)
        flying = self._simulator.manager.environment.aircraft
        self._aircraft = [flying[aircraft.callsign] for aircraft in scenario.aircraft]
        for twin, aircraft in zip(self._aircraft, scenario.aircraft, strict=True):
            twin.aircraft_type = aircraft.type
            twin.selected_instructions.fl = aircraft.fl  # which it makes a whole number
            if scenario.performance == "table":
                twin.selected_instructions.cas = None
        return self._report()

    def issue(self, instruction: Instruction) -> None:
        told = self._simulator.action(
            [
                {
                    "callsign": instruction.callsign,
                    "kind": kind,
                    "value": value,
                    "agent": "skystack",
                }
                for kind, value in bluebird_actions(instruction)
            ]
        )
        if not told:
            raise PlatformError(f"BluebirdDT refused {instruction}")

    def advance(self) -> Report:
        self._simulator.evolve(float(CYCLE_S))
        flying = self._simulator.manager.environment.aircraft
        lost = [twin.callsign for twin in self._aircraft if twin.callsign not in flying]
        if lost:
            raise PlatformError(f"BluebirdDT has lost {', '.join(lost)}")
        self._aircraft = [flying[twin.callsign] for twin in self._aircraft]
        return self._report()

    def close(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None

    def _report(self) -> Report:
        def column(values: list[float]) -> np.ndarray:
            return np.array(values, dtype=np.float64)

        twins = self._aircraft
        selected = [twin.selected_instructions for twin in twins]
        own = [
            told.heading is None or twin.on_route
            for told, twin in zip(selected, twins, strict=True)
        ]
        return Report(
            lat=column([twin.lat for twin in twins]),
            lon=column([twin.lon for twin in twins]),
            fl=column([twin.fl for twin in twins]),
            heading_deg=column([twin.heading for twin in twins]),
            cleared_heading_deg=column(
                [
                    twin.heading if free else told.heading
                    for twin, told, free in zip(twins, selected, own, strict=True)
                ]
            ),
            cleared_fl=column([told.fl for told in selected]),
            ground_speed_kt=column([twin.ground_speed or twin.speed_tas for twin in twins]),
            vertical_speed_ft_min=column([twin.vertical_speed for twin in twins]),
        )


def _simulator(scenario: Scenario) -> Any:
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
        _add(manager, aircraft, speed_kt)
    table = scenario.performance == "table"
    # One second a step; a fix counts as reached within 0.5 and 2 NM, as where they are made.
    if scenario.fleet:
        predictor = _FleetPredictor({each.type: each.table() for each in scenario.fleet})
    else:
        predictor = LinearPredictor(1.0, 0.5) if table else SimplePredictor(1.0, 2.0)
    return manager.to_simulator(
        scenario_name="skystack",
        predictor=predictor,
        attach_context_to_logger=False,
        save_log_to_file=False,
        autosave_interval=None,
        log_filename="skystack",
    )


class _FleetPredictor(LinearPredictor):  # type: ignore[misc]
    """Flies each type by a table of ours: BluebirdDT's own know classes of weight alone."""

    def __init__(self, tables: dict[str, TablePerformance]) -> None:
        super().__init__(1.0, 0.5)
        self._tables = tables

    def update_total_speeds(self, aircraft: Any) -> None:
        table = self._tables[aircraft.aircraft_type]
        aircraft.speed_tas = table.airspeed_kt(aircraft.fl, _phase(aircraft))

    def update_vertical_speeds(self, aircraft: Any) -> None:
        table, phase = self._tables[aircraft.aircraft_type], _phase(aircraft)
        at_ceiling = phase > 0 and aircraft.fl >= table.ceiling_fl
        aircraft.vertical_speed = 0.0 if at_ceiling else phase * table.rate_ft_min


def _phase(aircraft: Any) -> int:
    """1 in a climb, -1 in a descent, 0 in level flight."""
    to_go = aircraft.selected_fl - aircraft.fl
    return (to_go > 0.0) - (to_go < 0.0)


def _add(manager: Any, aircraft: Aircraft, speed_kt: float) -> None:
    manager.add_aircraft_with_coordinations(
        aircraft_start_time=0.0,
        callsign=aircraft.callsign,
        pos=Pos3D(aircraft.lat, aircraft.lon, aircraft.fl),
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
    area = Area([Pos2D(lat, lon) for lat, lon in sector.area])
    volume = Volume(area, *sector.levels_fl)
    fixes = Fixes({name: Pos2D(lat, lon) for name, (lat, lon) in sector.fixes.items()})
    return Airspace({sector.name: Sector([volume])}, fixes)


def sector_named(name: str) -> OurSector:
    """A sector of BluebirdDT's own, read from it now: area, levels, fixes and routes.

    Raises InputError for a name that it does not know, and for an airspace of several volumes or
    with routes that do not lead through one area.
    """
    if name not in AirspaceLoader.list_airspaces():
        raise unknown_name("sector of BluebirdDT", name, AirspaceLoader.list_airspaces())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of shapely, for its authors
        airspace, routes, sector_name = AirspaceLoader.load(name)
    volumes = airspace.sectors[sector_name].volumes
    with inside(f"BluebirdDT's {name}"):
        if len(volumes) != 1:
            raise InputError(f"has {len(volumes)} volumes (allowed: 1)")
        corners = [(at.lon, at.lat) for at in volumes[0].area.boundary_vertices]
        fixes = {fix: Point(at.lat, at.lon) for fix, at in airspace.fixes.places.items()}
        entry = SectorEntry(
            name=f"bluebird:{name}",
            levels_fl=(int(volumes[0].min_fl), int(volumes[0].max_fl)),
            area={"type": "Polygon", "coordinates": [corners]},
            fixes=fixes,
            routes=tuple(tuple(route.filed) for route in routes),
        )
        return make_sector(entry)
