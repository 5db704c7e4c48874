"""Scenarios in BlueSky's language: the commands that begin one, that clear, and the `.scn` file.

The adapter stacks the very commands that stand in the file, so that plain BlueSky flies a file as
the adapter flew the scenario. A clearance of cycle k stands at 6 k seconds: BlueSky obeys it from
the first second of cycle k+1, one cycle earlier than our simulator does.
"""

import re
from collections.abc import Iterable

import numpy as np

from skystack.errors import InputError
from skystack.platforms.instruction import Instruction
from skystack.platforms.languages import bluesky_commands
from skystack.platforms.protocol import check_types
from skystack.simulator.performance import (
    ConstantPerformance,
    Performance,
    TablePerformance,
    tas_from_cas,
    tas_from_mach,
)
from skystack.simulator.scenario_file import Aircraft, GivenClearance, Scenario
from skystack.simulator.simulator import CYCLE_S

SUBSTITUTES = {"B753": "B752"}
"""What is flown in place of types that BlueSky's performance model lacks."""
_FIXED_WING = """
A124 A19N A20N A21N A306 A310 A318 A319 A320 A321 A332 A333 A343 A359 A388 AT72 AT75 AT76
B37M B38M B39M B3XM B733 B734 B735 B737 B738 B739 B744 B748 B752 B762 B763 B772 B773 B77L
B77W B788 B789 C25A C525 C550 C56X CRJ2 CRJ9 E145 E170 E190 E195 E290 E75L GL5T GLF5 GLF6
LJ45 MD11 PC24 SU95
"""
TYPES = frozenset(_FIXED_WING.split())
"""Fixed-wing types that BlueSky knows (OpenAP 2.6); it silently flies another for any other."""
STEP_S = 1
"""BlueSky's time step."""
_CRUISE = 1
_CALLSIGN = re.compile(r"[A-Z0-9]+")


def flown_type(aircraft_type: str) -> str:
    """The type that BlueSky flies for an aircraft of a type."""
    return SUBSTITUTES.get(aircraft_type, aircraft_type)


def check_flown_types(scenario: Scenario) -> None:
    """Raise InputError for an aircraft type that BlueSky would silently replace."""
    allowed = f"a type that it knows, as {', '.join(SUBSTITUTES.values())}"
    check_types(scenario, TYPES | set(SUBSTITUTES), "BlueSky", allowed)


def selected_speed(model: Performance, fl: float) -> str:
    """What a performance model flies in cruise at a level, as BlueSky takes a selected speed.

    Calibrated airspeed [kt], or `M` and a Mach number. Raises InputError for a model whose cruise
    speed is not known.
    """
    level = np.array([fl])
    mach_1_kt = tas_from_mach(level, 1.0).item()
    if isinstance(model, TablePerformance):
        cas, mach = model.cas_kt(level, _CRUISE), model.mach[_CRUISE]
        below_crossover = tas_from_cas(level, cas).item() <= mach * mach_1_kt
        return f"{cas.item():.6f}" if below_crossover else f"M{mach:.8f}"
    if isinstance(model, ConstantPerformance):
        return f"M{model.airspeed_kt / mach_1_kt:.8f}"
    raise InputError(f"performance is {type(model).__name__} (allowed: table, constant)")


def start_commands(scenario: Scenario, callsigns: Iterable[str]) -> list[str]:
    """The commands that create a scenario's aircraft, under other callsigns, in level flight."""
    commands = [f"DT {STEP_S}"]
    for callsign, aircraft in zip(callsigns, scenario.aircraft, strict=True):
        speed = selected_speed(scenario.model_of(aircraft), aircraft.fl)
        commands += [
            f"CRE {callsign} {flown_type(aircraft.type)} {aircraft.lat:.10f} {aircraft.lon:.10f} "
            f"{aircraft.heading_deg:.10f} {100.0 * aircraft.fl:.6f} {speed}",
            f"SPD {callsign} {speed}",
        ]
        if aircraft.own_navigation:
            commands += _route_commands(scenario, callsign, aircraft)
        commands.append(f"VNAV {callsign} OFF")
    return commands


def _route_commands(scenario: Scenario, callsign: str, aircraft: Aircraft) -> list[str]:
    """The route as fly-by waypoints; the first fix lies at the start and is not flown to."""
    fixes = [scenario.sector.fixes[name] for name in aircraft.route[1:]]
    waypoints = [f"ADDWPT {callsign} {lat:.10f} {lon:.10f}" for lat, lon in fixes]
    return [*waypoints, f"LNAV {callsign} ON"]


def clearance_commands(instruction: Instruction, model: Performance) -> list[str]:
    """An instruction as BlueSky takes it; with a level goes the speed of cruise there."""
    commands = bluesky_commands(instruction)
    if instruction.level_fl is not None:
        speed = selected_speed(model, float(instruction.level_fl))
        commands.append(f"SPD {instruction.callsign} {speed}")
    return commands


def scenario_text(scenario: Scenario) -> str:
    """The text of a BlueSky scenario file (`.scn`) that flies a scenario with its clearances.

    Raises InputError for what such a file cannot say: a type that BlueSky does not know, a callsign
    other than capital letters and digits, a direction of turn, which BlueSky chooses itself. A
    file cannot know how high BlueSky lets a type climb.
    """
    check_flown_types(scenario)
    for aircraft in scenario.aircraft:
        if not _CALLSIGN.fullmatch(aircraft.callsign):
            raise InputError(
                f"callsign is {aircraft.callsign!r} "
                "(allowed in a BlueSky scenario file: capital letters and digits)"
            )
    model = {aircraft.callsign: scenario.model_of(aircraft) for aircraft in scenario.aircraft}
    callsigns = [aircraft.callsign for aircraft in scenario.aircraft]
    timed = [(0, command) for command in start_commands(scenario, callsigns)]
    for cycle, told in scenario.transmissions().items():
        for given in told:
            commands = clearance_commands(_instruction(given), model[given.callsign])
            timed += [(cycle, command) for command in commands]
    timed.append((scenario.cycles, "HOLD"))
    return "".join(f"{_clock(cycle)}>{command}\n" for cycle, command in timed)


def _instruction(given: GivenClearance) -> Instruction:
    """What a file's clearance says, if BlueSky can be told it."""
    if given.turn in ("left", "right"):
        raise InputError(
            f"turn is {given.turn!r} in cycle {given.cycle} for {given.callsign} "
            "(allowed in a BlueSky scenario file: shortest)"
        )
    return Instruction(given.callsign, heading_deg=given.heading_deg, level_fl=given.fl)


def _clock(cycle: int) -> str:
    """The time of a cycle as `hh:mm:ss.00`."""
    minutes, seconds = divmod(cycle * CYCLE_S, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}.00"
