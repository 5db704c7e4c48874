"""Scenario files: traffic and clearances as JSON, checked before they reach an array.

`docs/formats.md` (section "Scenario file") describes the fields.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import msgspec
from msgspec import Meta

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import MAX_DISTANCE_NM, Sector
from skystack.airspace.sectors import find_sector
from skystack.errors import InputError, error_context, unknown_name
from skystack.io.json_file import convert, is_name, not_allowed, read_json
from skystack.simulator.fleet import MOST_TYPES, AircraftType, fleet
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

MOST_POSITIONS = 500_000
"""Aircraft times cycles: flown, written and replayed in seconds and within 1 GB."""
TURNS = ("shortest", "left", "right")

Name = Annotated[str, Meta(max_length=40)]
Level = Annotated[int, Meta(ge=0, le=600, multiple_of=10)]


class ScheduledClearance(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `clearances`: what one aircraft is told before cycle `cycle` + 1 is flown."""

    cycle: int
    callsign: Name
    heading_deg: Annotated[int, Meta(ge=0, le=360)] | None = None
    turn: Name | None = None
    """A name in `TURNS`; "shortest" where none is given."""
    fl: int | None = None


class _AircraftEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of `aircraft` as it stands in the file."""

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
    """The whole file as it stands."""

    sector: Annotated[str, Meta(max_length=200)]
    """A name, or a sector file in the scenario's folder."""
    cycles: Annotated[int, Meta(ge=1, le=10_000)]
    aircraft: Annotated[tuple[_AircraftEntry, ...], Meta(min_length=1, max_length=200)]
    levels_fl: tuple[Level, Level] | None = None
    performance: Name = "table"
    fleet: Annotated[tuple[AircraftType, ...], Meta(max_length=MOST_TYPES)] = ()
    clearances: Annotated[tuple[ScheduledClearance, ...], Meta(max_length=10_000)] = ()


@dataclass(frozen=True)
class Aircraft:
    """An aircraft at cycle 0."""

    callsign: str
    type: str
    """An ICAO designator. Of a type that is not in the scenario's fleet each platform decides
    whether it can fly it."""
    route: tuple[str, ...]
    lat: float
    lon: float
    fl: float
    """Whole ticks, see `on_tick`."""
    heading_deg: float
    exit_fl: int
    own_navigation: bool


@dataclass(frozen=True)
class Scenario:
    """A checked scenario: who flies where, and what they are told when."""

    sector: Sector
    """With the scenario's levels."""
    performance: str
    cycles: int
    aircraft: tuple[Aircraft, ...]
    clearances: tuple[ScheduledClearance, ...]
    """In the order of the file: of two in one cycle the later one wins."""
    fleet: tuple[AircraftType, ...] = ()
    """The speeds and rates of its types; empty where all fly those of `performance`."""

    def model(self) -> Performance:
        """The performance of all aircraft."""
        return fleet(self.fleet, "fleet") if self.fleet else performance_named(self.performance)

    def performance_of(self, aircraft_type: str) -> TablePerformance | ConstantPerformance:
        """The performance of a type; that of `performance` where the fleet does not have it."""
        for member in self.fleet:
            if member.type == aircraft_type:
                return member.table()
        model = performance_named(self.performance)
        assert isinstance(model, TablePerformance | ConstantPerformance)
        return model

    def simulator(self) -> Simulator:
        """The simulator that flies it."""
        own_navigation = any(aircraft.own_navigation for aircraft in self.aircraft)
        return Simulator(self.sector, self.model(), own_navigation)

    def initial_traffic(self, simulator: Simulator) -> Traffic:
        """The aircraft at cycle 0, in level flight; unknown types as the first that is known."""
        aircraft, types = self.aircraft, simulator.performance.types
        kinds = [types.index(one.type) if one.type in types else 0 for one in aircraft]
        kind = jnp.array(kinds, dtype=jnp.int32)
        level = jnp.array([ticks(one.fl) for one in aircraft], dtype=jnp.float32)
        position = self.sector.plane.to_plane(
            [one.lat for one in aircraft], [one.lon for one in aircraft]
        )
        return start(
            position_nm=jnp.asarray(position, dtype=jnp.float32),
            heading_deg=jnp.array([one.heading_deg for one in aircraft], dtype=jnp.float32),
            level_ticks=level,
            route=jnp.array(
                [self.sector.route_index(one.route) for one in aircraft], dtype=jnp.int32
            ),
            ground_speed_kt=simulator.level_ground_speed_kt(level, kind),
            own_navigation=jnp.array([one.own_navigation for one in aircraft]),
            kind=kind,
        )

    def transmissions(self) -> dict[int, list[ScheduledClearance]]:
        """Who is told what before each cycle: one entry for each aircraft that is told anything.

        Of several entries for one aircraft in one cycle the later wins and leaves what it does
        not name.
        """
        merged: dict[int, dict[str, ScheduledClearance]] = {}
        for given in self.clearances:
            told = merged.setdefault(given.cycle, {})
            if (before := told.get(given.callsign)) is not None:
                later = before if given.heading_deg is None else given
                heading, turn = later.heading_deg, later.turn
                fl = before.fl if given.fl is None else given.fl
                given = ScheduledClearance(given.cycle, given.callsign, heading, turn, fl)  # noqa: PLW2901
            told[given.callsign] = given
        return {cycle: list(told.values()) for cycle, told in sorted(merged.items())}


_ENTRIES: dict[str, type[msgspec.Struct]] = {
    "": _FileEntry,
    "aircraft": _AircraftEntry,
    "fleet": AircraftType,
    "clearances": ScheduledClearance,
}


def load_scenario(path: Path) -> Scenario:
    """The scenario of a JSON file, checked.

    Raises InputError for a file that cannot be read or flown: one line with the file, the field,
    its value and what is allowed.
    """
    with error_context(str(path)):
        return _checked(convert(read_json(path), _ENTRIES), path.parent)


def _checked(file: _FileEntry, folder: Path) -> Scenario:
    """What the types alone do not tell; a sector's file lies in the folder."""
    count, cycles = len(file.aircraft), file.cycles
    if count * cycles > MOST_POSITIONS:
        raise InputError(
            f"{count} aircraft for {cycles} cycles are {count * cycles:,} positions (allowed: "
            f"{MOST_POSITIONS:,}: with so many aircraft {MOST_POSITIONS // count:,} cycles)"
        )
    with error_context("sector"):
        sector = find_sector(file.sector, folder)
    low, high = file.levels_fl or sector.levels_fl
    if low >= high:
        raise not_allowed("levels_fl", [low, high], "the lowest level, then a higher one")
    sector = replace(sector, levels_fl=(low, high))
    with error_context("performance"):
        performance_named(file.performance)
    _check_fleet(file)
    _check_callsigns(file.aircraft)
    aircraft = tuple(
        _checked_aircraft(f"aircraft[{index}]", entry, sector)
        for index, entry in enumerate(file.aircraft)
    )
    callsigns = {entry.callsign for entry in file.aircraft}
    for index, given in enumerate(file.clearances):
        where = f"clearances[{index}]"
        if given.callsign not in callsigns:
            with error_context(f"{where}.callsign"):
                raise unknown_name("callsign", given.callsign, callsigns)
        if not 0 <= given.cycle < file.cycles:
            allowed = f"0 to {file.cycles - 1}, which is cycles - 1"
            raise not_allowed(f"{where}.cycle", given.cycle, allowed)
        _check_clearance(where, given, sector)
    return Scenario(sector, file.performance, file.cycles, aircraft, file.clearances, file.fleet)


def on_tick(fl: float) -> float:
    """The nearest level of whole ticks (1/60 ft): every simulator can start an aircraft there."""
    return ticks(fl) / TICKS_PER_FL


def _check_fleet(file: _FileEntry) -> None:
    if not file.fleet:
        return
    if file.performance != "table":
        raise not_allowed("performance", file.performance, '"table" where there is a fleet')
    known = fleet(file.fleet, "fleet").types
    for index, entry in enumerate(file.aircraft):
        if entry.type not in known:
            allowed = f"the types of the fleet: {', '.join(known)}"
            raise not_allowed(f"aircraft[{index}].type", entry.type, allowed)


def _check_callsigns(aircraft: tuple[_AircraftEntry, ...]) -> None:
    seen: dict[str, int] = {}
    for index, entry in enumerate(aircraft):
        callsign, where = entry.callsign, f"aircraft[{index}].callsign"
        if not is_name(callsign):
            allowed = "printable characters, none of them a blank at either end"
            raise not_allowed(where, callsign, allowed)
        if callsign in seen:
            other = f"aircraft[{seen[callsign]}]"
            raise not_allowed(where, callsign, f"a callsign of its own, {other} has this one")
        seen[callsign] = index


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
    given = "" if entry.exit_fl is not None else " (not given, so fl)"
    _check_level(f"{where}.exit_fl{given}", exit_fl, sector)
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


def _check_clearance(where: str, given: ScheduledClearance, sector: Sector) -> None:
    if given.heading_deg is None and given.fl is None:
        raise InputError(f"{where} clears nothing (allowed: heading_deg, fl or both)")
    if given.turn is not None and given.turn not in TURNS:
        with error_context(f"{where}.turn"):
            raise unknown_name("turn", given.turn, TURNS)
    if given.turn is not None and given.heading_deg is None:
        raise not_allowed(f"{where}.turn", given.turn, "only together with heading_deg")
    if given.fl is not None:
        _check_level(f"{where}.fl", given.fl, sector)


def _check_level(where: str, fl: int | float, sector: Sector) -> None:
    low, high = sector.levels_fl
    if fl % 10 != 0 or not low <= fl <= high:
        raise not_allowed(where, fl, f"multiples of 10 from {low} to {high}")
