"""Scenario files: traffic and clearances as JSON, fully checked before use.

`docs/formats.md` (section "Scenario file") describes the fields.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import msgspec
from msgspec import Meta
from msgspec.structs import replace as replace_fields

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import MAX_DISTANCE_NM, Sector
from skystack.airspace.sectors import find_sector
from skystack.errors import InputError, error_context, unknown_name
from skystack.io.json_file import is_name, read_json
from skystack.io.validation import convert, not_allowed
from skystack.simulator.fleet import AircraftType, fleet
from skystack.simulator.limits import MAX_AIRCRAFT, MAX_CYCLES, MAX_TYPES
from skystack.simulator.performance import (
    DEFAULT_TYPE,
    TICKS_PER_FL,
    ConstantPerformance,
    Performance,
    TablePerformance,
)
from skystack.simulator.performance import performance as performance_named
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic, start, ticks

MAX_AIRCRAFT_CYCLES = 500_000
"""The maximum number of aircraft times cycles. This many positions are simulated, written and
replayed within seconds and 1 GB."""
TURNS = ("shortest", "left", "right")

Name = Annotated[str, Meta(max_length=40)]
Level = Annotated[int, Meta(ge=0, le=600, multiple_of=10)]


class ScheduledClearance(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `clearances`: the clearance of one aircraft before cycle `cycle` + 1 is flown."""

    cycle: int
    callsign: Name
    heading_deg: Annotated[int, Meta(ge=0, le=360)] | None = None
    turn: Name | None = None
    """A name in `TURNS`. None means "shortest"."""
    fl: int | None = None
    direct_to: Name | None = None
    """A fix of the aircraft's route, on own navigation."""


class _AircraftEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `aircraft` in the file."""

    callsign: Name
    route: Annotated[tuple[Name, ...], Meta(min_length=2)]
    lat: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon: Annotated[float, Meta(ge=-180.0, le=180.0)]
    fl: float
    type: Name = DEFAULT_TYPE
    heading_deg: Annotated[float, Meta(ge=0.0, le=360.0)] | None = None
    exit_fl: int | None = None
    own_navigation: bool = False


class _FileEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The contents of the file."""

    sector: Annotated[str, Meta(max_length=200)]
    """A name, or a sector file in the scenario's folder or below."""
    cycles: Annotated[int, Meta(ge=1, le=MAX_CYCLES)]
    aircraft: Annotated[tuple[_AircraftEntry, ...], Meta(min_length=1, max_length=MAX_AIRCRAFT)]
    levels_fl: tuple[Level, Level] | None = None
    performance: Name = "table"
    fleet: Annotated[tuple[AircraftType, ...], Meta(max_length=MAX_TYPES)] = ()
    clearances: Annotated[tuple[ScheduledClearance, ...], Meta(max_length=10_000)] = ()


@dataclass(frozen=True)
class Aircraft:
    """An aircraft at cycle 0."""

    callsign: str
    type: str
    """ICAO type designator. Each platform decides whether it supports a type that is not in the
    scenario's fleet."""
    route: tuple[str, ...]
    lat: float
    lon: float
    fl: float
    """A flight level on a whole tick, see `on_tick`."""
    heading_deg: float
    exit_fl: int
    own_navigation: bool


@dataclass(frozen=True)
class Scenario:
    """A checked scenario: the sector, the aircraft and the scheduled clearances."""

    sector: Sector
    """The sector, with the scenario's levels."""
    performance: str
    cycles: int
    aircraft: tuple[Aircraft, ...]
    clearances: tuple[ScheduledClearance, ...]
    """In the order of the file. Of two in the same cycle the later takes precedence."""
    fleet: tuple[AircraftType, ...] = ()
    """The types with their own speeds and rates. If empty, all aircraft use `performance`."""

    def model(self) -> Performance:
        """The performance model of the scenario."""
        return fleet(self.fleet, "fleet") if self.fleet else performance_named(self.performance)

    def performance_of(self, aircraft_type: str) -> TablePerformance | ConstantPerformance:
        """The performance of a type in the fleet, otherwise the model `performance`."""
        for member in self.fleet:
            if member.type == aircraft_type:
                return member.table()
        model = performance_named(self.performance)
        assert isinstance(model, TablePerformance | ConstantPerformance)
        return model

    def simulator(self) -> Simulator:
        """The simulator for the scenario."""
        own_navigation = any(aircraft.own_navigation for aircraft in self.aircraft)
        return Simulator(self.sector, self.model(), own_navigation or self.has_directs)

    @property
    def has_directs(self) -> bool:
        """Whether aircraft are cleared direct to fixes."""
        return any(clearance.direct_to is not None for clearance in self.clearances)

    def initial_traffic(self, simulator: Simulator) -> Traffic:
        """The aircraft at cycle 0, in level flight.

        Aircraft of a type that the performance model does not have fly as its first type.
        """
        aircraft, types = self.aircraft, simulator.performance.types
        kinds = [types.index(each.type) if each.type in types else 0 for each in aircraft]
        kind = jnp.array(kinds, dtype=jnp.int32)
        level = jnp.array([ticks(each.fl) for each in aircraft], dtype=jnp.float32)
        position = self.sector.plane.to_plane(
            [each.lat for each in aircraft], [each.lon for each in aircraft]
        )
        traffic = start(
            position_nm=jnp.asarray(position, dtype=jnp.float32),
            heading_deg=jnp.array([each.heading_deg for each in aircraft], dtype=jnp.float32),
            level_ticks=level,
            route=jnp.array(
                [self.sector.route_index(each.route) for each in aircraft], dtype=jnp.int32
            ),
            ground_speed_kt=simulator.level_ground_speed_kt(level, kind),
            own_navigation=jnp.array([each.own_navigation for each in aircraft]),
            kind=kind,
        )
        fix = jnp.zeros_like(traffic.next_fix) if self.has_directs else None
        return traffic._replace(cleared_fix=fix)

    def transmissions(self) -> dict[int, list[ScheduledClearance]]:
        """The clearances before each cycle, by cycle, at most one per aircraft.

        Several clearances of one aircraft in the same cycle are merged: a later one replaces only
        the elements (heading or fix, level) that it contains.
        """
        merged: dict[int, dict[str, ScheduledClearance]] = {}
        for clearance in self.clearances:
            by_callsign = merged.setdefault(clearance.cycle, {})
            callsign = clearance.callsign
            if (earlier := by_callsign.get(callsign)) is not None:
                turns = clearance.heading_deg is not None or clearance.direct_to is not None
                latest = clearance if turns else earlier
                fl = earlier.fl if clearance.fl is None else clearance.fl
                clearance = replace_fields(latest, cycle=clearance.cycle, fl=fl)  # noqa: PLW2901
            by_callsign[callsign] = clearance
        return {cycle: list(each.values()) for cycle, each in sorted(merged.items())}


def load_scenario(path: Path) -> Scenario:
    """The checked scenario of a JSON file.

    Raises InputError for a file that cannot be read or flown. The message is one line with the
    file, the field, its value and the allowed values.
    """
    with error_context(str(path)):
        return _checked(convert(read_json(path), _FileEntry), path.parent)


def _checked(file: _FileEntry, folder: Path) -> Scenario:
    """Check what the types alone do not ensure. `folder` is that of the scenario file."""
    count, cycles = len(file.aircraft), file.cycles
    if count * cycles > MAX_AIRCRAFT_CYCLES:
        raise InputError(
            f"{count} aircraft for {cycles} cycles are {count * cycles:,} positions (allowed: "
            f"{MAX_AIRCRAFT_CYCLES:,}, which is {MAX_AIRCRAFT_CYCLES // count:,} cycles for "
            f"{count} aircraft)"
        )
    with error_context("sector"):
        sector = find_sector(file.sector, folder)
    low, high = file.levels_fl or sector.levels_fl
    if low >= high:
        raise not_allowed("levels_fl", [low, high], "the lowest level, then a higher level")
    sector = replace(sector, levels_fl=(low, high))
    with error_context("performance"):
        performance_named(file.performance)
    _check_fleet(file)
    _check_callsigns(file.aircraft)
    aircraft = tuple(
        _checked_aircraft(f"aircraft[{index}]", entry, sector)
        for index, entry in enumerate(file.aircraft)
    )
    routes = {entry.callsign: entry.route for entry in file.aircraft}
    for index, clearance in enumerate(file.clearances):
        where = f"clearances[{index}]"
        if clearance.callsign not in routes:
            with error_context(f"{where}.callsign"):
                raise unknown_name("callsign", clearance.callsign, routes)
        if not 0 <= clearance.cycle < file.cycles:
            allowed = f"0 to {file.cycles - 1}, which is cycles - 1"
            raise not_allowed(f"{where}.cycle", clearance.cycle, allowed)
        _check_clearance(where, clearance, sector, routes[clearance.callsign])
    return Scenario(sector, file.performance, file.cycles, aircraft, file.clearances, file.fleet)


def on_tick(fl: float) -> float:
    """The nearest level on a whole tick (1/60 ft). Every platform can start an aircraft there."""
    return ticks(fl) / TICKS_PER_FL


def _check_fleet(file: _FileEntry) -> None:
    if not file.fleet:
        return
    if file.performance != "table":
        raise not_allowed("performance", file.performance, '"table" with a fleet')
    known = fleet(file.fleet, "fleet").types
    for index, entry in enumerate(file.aircraft):
        if entry.type not in known:
            allowed = f"the types of the fleet: {', '.join(known)}"
            raise not_allowed(f"aircraft[{index}].type", entry.type, allowed)


def _check_callsigns(aircraft: tuple[_AircraftEntry, ...]) -> None:
    first_index: dict[str, int] = {}
    for index, entry in enumerate(aircraft):
        callsign, where = entry.callsign, f"aircraft[{index}].callsign"
        if not is_name(callsign):
            allowed = "printable characters, without leading or trailing spaces"
            raise not_allowed(where, callsign, allowed)
        if callsign in first_index:
            other = f"aircraft[{first_index[callsign]}]"
            raise not_allowed(where, callsign, f"a unique callsign; {other} has this one")
        first_index[callsign] = index


def _checked_aircraft(where: str, entry: _AircraftEntry, sector: Sector) -> Aircraft:
    for index, fix in enumerate(entry.route):
        if fix not in sector.fixes:
            with error_context(f"{where}.route[{index}]"):
                raise unknown_name("fix", fix, sector.fixes)
    with error_context(f"{where}.route"):
        sector.route_index(entry.route)
    _, distance_nm = geodesic_leg(sector.origin, (entry.lat, entry.lon))
    if distance_nm > MAX_DISTANCE_NM:
        raise InputError(
            f"{where} is {distance_nm:.0f} NM from the origin of {sector.name} "
            f"at lat {entry.lat}, lon {entry.lon} (allowed: at most {MAX_DISTANCE_NM:.0f} NM)"
        )
    low, high = sector.levels_fl
    fl = on_tick(entry.fl)
    if not low <= fl <= high:
        raise not_allowed(f"{where}.fl", entry.fl, f"{low} to {high}")
    exit_fl = fl if entry.exit_fl is None else entry.exit_fl
    note = "" if entry.exit_fl is not None else " (the default is fl)"
    _check_level(f"{where}.exit_fl{note}", exit_fl, sector)
    heading = entry.heading_deg
    return Aircraft(
        callsign=entry.callsign,
        type=entry.type,
        route=entry.route,
        lat=entry.lat,
        lon=entry.lon,
        fl=fl,
        heading_deg=sector.first_heading_deg(entry.route) if heading is None else heading % 360.0,
        exit_fl=int(exit_fl),
        own_navigation=entry.own_navigation,
    )


def _check_clearance(
    where: str, clearance: ScheduledClearance, sector: Sector, route: tuple[str, ...]
) -> None:
    heading, turn, fl = clearance.heading_deg, clearance.turn, clearance.fl
    direct_to = clearance.direct_to
    if heading is None and fl is None and direct_to is None:
        raise InputError(
            f"{where} has no heading, fix or level "
            "(allowed: heading_deg or direct_to, with or without fl, or fl alone)"
        )
    if direct_to is not None:
        if heading is not None:
            raise not_allowed(f"{where}.direct_to", direct_to, "only without heading_deg")
        if direct_to not in route[1:]:
            with error_context(f"{where}.direct_to"):
                raise unknown_name("fix of the route", direct_to, route[1:])
    if turn is not None and turn not in TURNS:
        with error_context(f"{where}.turn"):
            raise unknown_name("turn", turn, TURNS)
    if turn is not None and heading is None:
        raise not_allowed(f"{where}.turn", turn, "only together with heading_deg")
    if fl is not None:
        _check_level(f"{where}.fl", fl, sector)


def _check_level(where: str, fl: int | float, sector: Sector) -> None:
    low, high = sector.levels_fl
    if fl % 10 != 0 or not low <= fl <= high:
        raise not_allowed(where, fl, f"multiples of 10 from {low} to {high}")
