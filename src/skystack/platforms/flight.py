"""Fly a scenario on a platform, issuing the clearances that its file names."""

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
    """What was issued before which cycle: one transmission each, in the words of what is flown."""


def fly_scenario(platform: Platform, scenario: Scenario) -> Flight:
    """All cycles of a scenario.

    A clearance of cycle k shows as cleared in row k+1. Raises what the platform raises.
    """
    reports = [platform.reset(scenario)]
    clearances = scenario.transmissions()
    index = {aircraft.callsign: number for number, aircraft in enumerate(scenario.aircraft)}
    issued = []
    for cycle in range(scenario.cycles):
        instructions = [instruction_of(given) for given in clearances.get(cycle, [])]
        for instruction in instructions:
            platform.issue(instruction)
        reports.append(platform.advance())
        adopted = reports[-2] if platform.adoption.at_once else reports[-1]
        for instruction in instructions:
            who = index[instruction.callsign]
            heading_deg, fl = float(adopted.heading_deg[who]), float(adopted.fl[who])
            issued.append((cycle, worded(instruction, heading_deg, fl, platform.adoption)))
    return Flight(reports, issued)


def instruction_of(given: GivenClearance) -> Instruction:
    """A file's clearance; a direction of turn is obeyed where one is given."""
    obeyed: dict[str | None, Literal["left", "right"]] = {"left": "left", "right": "right"}
    turn = obeyed.get(given.turn)
    return Instruction(given.callsign, given.heading_deg, turn, turn is not None, given.fl)


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
