"""Fly a scenario on a platform, with the clearances of its file."""

from typing import Literal, NamedTuple

import numpy as np

from skystack.platforms.adoption import in_words
from skystack.platforms.instruction import Instruction
from skystack.platforms.protocol import Platform, Report
from skystack.simulator.scenario_file import Scenario, ScheduledClearance
from skystack.simulator.simulator import CYCLE_S


class Flight(NamedTuple):
    """A scenario flown on a platform."""

    reports: list[Report]
    """Rows 0 (the start) to `cycles`."""
    issued: list[tuple[int, Instruction]]
    """The transmissions, each with its cycle, in the wording of what was then flown."""


def fly_scenario(platform: Platform, scenario: Scenario) -> Flight:
    """Fly all cycles of a scenario.

    A clearance of cycle k first appears in row k+1. Raises what the platform raises.
    """
    reports = [_owned(platform.reset(scenario))]
    transmissions = scenario.transmissions()
    issued = []
    for cycle in range(scenario.cycles):
        for given in transmissions.get(cycle, []):
            issued.append((cycle, command_of(given)))
            platform.issue(issued[-1][1])
        reports.append(_owned(platform.advance()))
    return Flight(reports, _with_wording(platform, scenario, reports, issued))


def _owned(report: Report) -> Report:
    """A copy: a platform may reuse the same arrays for all its reports."""
    return Report(*map(np.array, report))


def command_of(given: ScheduledClearance) -> Instruction:
    """A file's clearance as an instruction to a platform."""
    directions: dict[str | None, Literal["left", "right"]] = {"left": "left", "right": "right"}
    turn = directions.get(given.turn)
    return Instruction(
        given.callsign,
        given.heading_deg,
        turn,
        turn is not None,
        given.fl,
        direct_to=given.direct_to,
    )


def _with_wording(
    platform: Platform,
    scenario: Scenario,
    reports: list[Report],
    issued: list[tuple[int, Instruction]],
) -> list[tuple[int, Instruction]]:
    index = {aircraft.callsign: number for number, aircraft in enumerate(scenario.aircraft)}
    adopted = [
        (reports[cycle + platform.adoption.cycles], index[command.callsign])
        for cycle, command in issued
    ]
    heading_deg = np.array([report.heading_deg[aircraft] for report, aircraft in adopted])
    fl = np.array([report.fl[aircraft] for report, aircraft in adopted])
    commands = [command for _, command in issued]
    words = in_words(commands, heading_deg, fl, platform.adoption)
    return [(cycle, each) for (cycle, _), each in zip(issued, words, strict=True)]


def flight_rows(scenario: Scenario, flight: Flight) -> dict[str, np.ndarray]:
    """A flight as columns of equal length, with one row per cycle and aircraft, in this order.

    Numbers are float64; `cycle` and `time_s` are int32.
    """
    count = len(scenario.aircraft)
    cycle = np.repeat(np.arange(len(flight.reports), dtype=np.int32), count)
    columns = Report(*(np.concatenate(values) for values in zip(*flight.reports, strict=True)))
    return {
        "callsign": np.tile([one.callsign for one in scenario.aircraft], len(flight.reports)),
        "cycle": cycle,
        "time_s": cycle * np.int32(CYCLE_S),
        **columns._asdict(),
    }
