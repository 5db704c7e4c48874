"""Fly a scenario on a platform, giving the clearances that its file names."""

from typing import Literal, NamedTuple

import numpy as np

from skystack.platforms.instruction import Instruction, worded
from skystack.platforms.protocol import Platform, Report
from skystack.simulator.scenario_file import GivenClearance, Scenario
from skystack.simulator.simulator import CYCLE_S


class Flight(NamedTuple):
    """What a platform made of a scenario."""

    reports: list[Report]
    """Rows 0 (the start) to `cycles`."""
    issued: list[tuple[int, Instruction]]
    """What was said before which cycle: one transmission each."""


def fly_scenario(platform: Platform, scenario: Scenario) -> Flight:
    """All cycles of a scenario.

    A clearance of cycle k shows as cleared in row k+1. Raises what the platform raises.
    """
    reports = [platform.reset(scenario)]
    told = scenario.transmissions()
    index = {aircraft.callsign: number for number, aircraft in enumerate(scenario.aircraft)}
    issued = []
    for cycle in range(scenario.cycles):
        for given in told.get(cycle, []):
            instruction = instruction_of(given, reports[-1], index[given.callsign])
            platform.issue(instruction)
            issued.append((cycle, instruction))
        reports.append(platform.advance())
    return Flight(reports, issued)


def instruction_of(given: GivenClearance, report: Report, aircraft: int) -> Instruction:
    """A file's clearance in the words that the traffic calls for."""
    obeyed: dict[str | None, Literal["left", "right"]] = {"left": "left", "right": "right"}
    return worded(
        given.callsign,
        given.heading_deg,
        given.fl,
        float(report.heading_deg[aircraft]),
        float(report.fl[aircraft]),
        obeyed.get(given.turn),
    )


def flight_rows(scenario: Scenario, flight: Flight) -> dict[str, np.ndarray]:
    """A flight as columns of one length, one row per cycle and aircraft in this order.

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
