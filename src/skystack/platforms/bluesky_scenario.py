"""Scenarios as BlueSky commands: those that start a scenario, clearances, and the `.scn` file.

The adapter stacks exactly the commands of the file, so that plain BlueSky flies the file as the
adapter flies the scenario. A clearance of cycle k is issued at 6 k seconds: BlueSky obeys it from
the first second of cycle k+1, one cycle earlier than skystack's simulator does.

Every level clearance includes the type's rate of climb and descent. BlueSky does not follow
skystack's speed schedule by itself, so the speed is selected again at the start of every cycle in
which a change of level or of the phase of flight has changed it.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from skystack.airspace.sector import LatLon
from skystack.errors import InputError
from skystack.platforms.flight import command_of
from skystack.platforms.instruction import Instruction
from skystack.platforms.languages import bluesky_commands
from skystack.platforms.protocol import check_types
from skystack.simulator.performance import (
    ConstantPerformance,
    TablePerformance,
    tas_from_cas,
    tas_from_mach,
)
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance
from skystack.simulator.simulator import CYCLE_S

SUBSTITUTES = {"B753": "B752"}
"""The types flown in place of those that BlueSky's performance model lacks."""
_FIXED_WING = """
A124 A19N A20N A21N A306 A310 A318 A319 A320 A321 A332 A333 A343 A359 A388 AT72 AT75 AT76
B37M B38M B39M B3XM B733 B734 B735 B737 B738 B739 B744 B748 B752 B762 B763 B772 B773 B77L
B77W B788 B789 C25A C525 C550 C56X CRJ2 CRJ9 E145 E170 E190 E195 E290 E75L GL5T GLF5 GLF6
LJ45 MD11 PC24 SU95
"""
TYPES = frozenset(_FIXED_WING.split())
"""Fixed-wing types that BlueSky knows (OpenAP 2.6); it silently replaces all others."""
STEP_S = 1
"""BlueSky's time step."""
Fixes = Mapping[str, LatLon]
"""The positions of fixes in degrees, by name."""
_CALLSIGN = re.compile(r"[A-Z0-9]+")


def flown_type(aircraft_type: str) -> str:
    """The type that BlueSky flies for an aircraft of a type."""
    return SUBSTITUTES.get(aircraft_type, aircraft_type)


def check_flown_types(scenario: Scenario) -> None:
    """Raise InputError for an aircraft type that BlueSky would silently replace."""
    allowed = f"a type that it knows, such as {', '.join(SUBSTITUTES.values())}"
    check_types(scenario, TYPES | set(SUBSTITUTES), "BlueSky", allowed)
    fleet = {member.type for member in scenario.fleet}
    for replaced in sorted(fleet & set(SUBSTITUTES)):
        substitute = flown_type(replaced)
        if substitute in fleet:  # the tables could not distinguish them
            raise InputError(
                f"the fleet has {replaced}, which BlueSky flies as {substitute}, and {substitute} "
                "itself (allowed: one of them)"
            )


@lru_cache(maxsize=4096)
def selected_speed(model: TablePerformance | ConstantPerformance, fl: float, phase: int = 0) -> str:
    """The speed of a performance model at a level, in the format of BlueSky's `SPD` command.

    Calibrated airspeed [kt], or `M` and a Mach number. The phase is 1 in a climb, 0 in cruise and
    -1 in a descent.
    """
    level = np.array([fl], dtype=float)
    mach_1_kt = tas_from_mach(level, 1.0).item()
    if isinstance(model, ConstantPerformance):
        return f"M{model.airspeed_kt / mach_1_kt:.8f}"
    cas, mach = model.cas_kt(level, 1 - phase), model.mach[1 - phase]
    below_crossover = tas_from_cas(level, cas).item() <= mach * mach_1_kt
    return f"{cas.item():.6f}" if below_crossover else f"M{mach:.8f}"


def phase_of(fl: float, selected_fl: float) -> int:
    """1 if an aircraft climbs to the selected level, -1 if it descends, 0 if it is at the level."""
    return (selected_fl > fl) - (selected_fl < fl)


def start_commands(scenario: Scenario, callsigns: Iterable[str]) -> list[str]:
    """The commands that create a scenario's aircraft, under other callsigns, in level flight."""
    commands = [f"DT {STEP_S}"]
    for callsign, aircraft in zip(callsigns, scenario.aircraft, strict=True):
        speed = selected_speed(scenario.performance_of(aircraft.type), aircraft.fl)
        start = BlueskyStart(
            flown_type(aircraft.type), aircraft.lat, aircraft.lon, aircraft.heading_deg, aircraft.fl
        )
        commands += create_commands(callsign, start, speed)
        if aircraft.own_navigation:
            commands += _route_commands(callsign, aircraft.route[1:], scenario.sector.fixes)
        commands.append(f"VNAV {callsign} OFF")
    return commands


class BlueskyStart(NamedTuple):
    """Where and how an aircraft begins, in level flight."""

    type: str
    """One of BlueSky's types."""
    lat: float
    lon: float
    heading_deg: float
    fl: float


def create_commands(callsign: str, start: BlueskyStart, speed: str) -> list[str]:
    """The commands that create an aircraft with a selected speed (`selected_speed`)."""
    return [
        f"CRE {callsign} {start.type} {start.lat:.10f} {start.lon:.10f} "
        f"{start.heading_deg:.10f} {100.0 * start.fl:.6f} {speed}",
        f"SPD {callsign} {speed}",
    ]


def _route_commands(callsign: str, names: Sequence[str], fixes: Fixes) -> list[str]:
    """Fixes as fly-by waypoints, and the command to fly along them."""
    points = [fixes[name] for name in names]
    waypoints = [f"ADDWPT {callsign} {lat:.10f} {lon:.10f}" for lat, lon in points]
    return [*waypoints, f"LNAV {callsign} ON"]


def clearance_commands(
    instruction: Instruction, route: Sequence[str], fixes: Fixes, rate_ft_min: float
) -> list[str]:
    """An instruction to an aircraft with a route as BlueSky commands.

    Fixes are given as positions. For a clearance direct to a fix, the route from that fix on
    replaces BlueSky's route. A change of level includes its rate [ft/min]; by default BlueSky's
    autopilot would climb and descend at 1,500 ft/min.
    """
    callsign, commands = instruction.callsign, bluesky_commands(instruction)
    if instruction.direct_to is not None:
        commands.append(f"DELRTE {callsign}")
        commands += _route_commands(callsign, route[route.index(instruction.direct_to) :], fixes)
    if instruction.level_fl is not None:
        commands.append(f"VS {callsign} {rate_ft_min:.6f}")
    return commands


def levels_fl(
    start_fl: float, cleared_fl: dict[int, int], cycles: int, rate_ft_min: float
) -> Iterator[tuple[float, float]]:
    """Level and selected level at the start of every cycle, as BlueSky flies them.

    `cleared_fl` maps a cycle to the level that is cleared before it. Each second the vertical speed
    changes by at most 300 ft/min, and a level is captured when it is less than 1.05 s away.
    """
    fl = selected = start_fl
    full_rate, rate = rate_ft_min / 6000.0, 0.0  # flight levels per second
    for cycle in range(cycles):
        selected = float(cleared_fl.get(cycle, selected))
        yield fl, selected
        for _ in range(CYCLE_S // STEP_S):
            to_go = selected - fl
            changes_level = abs(to_go) > 1.05 * max(full_rate, abs(rate))
            target_rate = changes_level * np.sign(to_go) * full_rate
            change = target_rate - rate
            rate = rate + np.sign(change) * 0.05 if abs(change) > 0.05 else target_rate
            fl = float(fl + rate) if changes_level else selected


def scenario_text(scenario: Scenario) -> str:
    """The text of a BlueSky scenario file (`.scn`) that flies a scenario with its clearances.

    Raises InputError for a type that BlueSky does not know, a callsign with other characters than
    capital letters and digits, and a direction of turn, which BlueSky chooses itself. The ceilings
    of types in BlueSky are not checked.
    """
    check_flown_types(scenario)
    for aircraft in scenario.aircraft:
        if not _CALLSIGN.fullmatch(aircraft.callsign):
            raise InputError(
                f"callsign is {aircraft.callsign!r} "
                "(allowed in a BlueSky scenario file: capital letters and digits)"
            )
    aircraft_of = {one.callsign: one for one in scenario.aircraft}
    timed = [(0, command) for command in start_commands(scenario, aircraft_of)]
    for cycle, given_then in scenario.transmissions().items():
        for given in given_then:
            aircraft = aircraft_of[given.callsign]
            rate_ft_min = scenario.performance_of(aircraft.type).rate_ft_min
            fixes = scenario.sector.fixes
            commands = clearance_commands(_instruction(given), aircraft.route, fixes, rate_ft_min)
            timed += [(cycle, command) for command in commands]
    for aircraft in scenario.aircraft:
        timed += _speed_commands(scenario, aircraft)
    timed.append((scenario.cycles, "HOLD"))
    in_order = sorted(timed, key=lambda each: each[0])
    return "".join(f"{_clock(cycle)}>{command}\n" for cycle, command in in_order)


def _speed_commands(scenario: Scenario, aircraft: Aircraft) -> Iterator[tuple[int, str]]:
    """The speed selections after the start, each with its cycle."""
    cleared_fl = {
        cycle: given.fl
        for cycle, given_then in scenario.transmissions().items()
        for given in given_then
        if given.callsign == aircraft.callsign and given.fl is not None
    }
    if not cleared_fl:
        return
    model = scenario.performance_of(aircraft.type)
    last = selected_speed(model, aircraft.fl)
    flown = levels_fl(aircraft.fl, cleared_fl, scenario.cycles, model.rate_ft_min)
    for cycle, (fl, selected_fl) in enumerate(flown):
        speed = selected_speed(model, fl, phase_of(fl, selected_fl))
        if speed != last:
            yield cycle, f"SPD {aircraft.callsign} {speed}"
        last = speed


def _instruction(given: ScheduledClearance) -> Instruction:
    """A file's clearance as an instruction. Raises InputError for a direction of turn."""
    if given.turn in ("left", "right"):
        raise InputError(
            f"turn is {given.turn!r} in cycle {given.cycle} for {given.callsign} "
            "(allowed in a BlueSky scenario file: shortest)"
        )
    return command_of(given)


def _clock(cycle: int) -> str:
    """The time of a cycle as `hh:mm:ss.00`."""
    minutes, seconds = divmod(cycle * CYCLE_S, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}.00"
