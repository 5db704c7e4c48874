"""Fly a scenario file on a platform and record the trajectories."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from skystack.errors import PlatformError, error_context
from skystack.evaluation.followed import STATUS, follow
from skystack.evaluation.tables import clearance_rows
from skystack.evaluation.writing import write_table
from skystack.io.files import check_output, scratch_folder
from skystack.io.json_file import finite
from skystack.platforms.flight import Flight, flight_rows, fly_scenario
from skystack.platforms.phraseology import written
from skystack.platforms.processes import TIME_LIMIT_S, in_processes
from skystack.platforms.registry import (
    OWN,
    check_platform,
    flown_type,
    open_platform,
    scenario_notes,
)
from skystack.simulator.scenario_file import Scenario, load_scenario


def simulate_file(
    path: Path, output: Path | None, platform: str = OWN, time_limit_s: float = TIME_LIMIT_S
) -> dict[str, Any]:
    """Fly a scenario file. Returns the last row of every aircraft, the clearances and the losses.

    Writes all rows as Parquet if `output` is given (its folder must exist). Raises InputError for a
    scenario that cannot be flown, an unavailable platform or a file that cannot be written;
    PlatformError if the platform fails.
    """
    check_platform(platform)
    scenario = load_scenario(path)
    if output is not None:
        check_output(output, path)
    flight = _fly(path, scenario, platform, time_limit_s)
    followed = follow(scenario, flight.reports)
    status = np.array(STATUS)[followed.status].reshape(-1)
    table = pa.table(flight_rows(scenario, flight) | {"status": status})
    if output is not None:
        embedded = {"aircraft": _aircraft(scenario), "clearances": _clearances(scenario, flight)}
        performance, types = scenario.performance, scenario.fleet
        write_table(output, table, scenario.sector, performance, types, embedded)
    least_nm = followed.min_separation_nm
    return {
        "scenario": str(path),
        "platform": platform,
        "types": {each.callsign: flown_type(platform, each.type) for each in scenario.aircraft},
        "notes": scenario_notes(platform, scenario),
        "rows": table.num_rows,
        "output": None if output is None else str(output),
        "clearances": [
            {"cycle": cycle, "callsign": instruction.callsign, "text": written(instruction)}
            for cycle, instruction in flight.issued
        ],
        "losses_of_separation": followed.losses,
        "min_separation_nm": finite(least_nm),
        "final": table.slice(table.num_rows - len(scenario.aircraft)).to_pylist(),
    }


def _aircraft(scenario: Scenario) -> list[dict[str, Any]]:
    """The aircraft, with the columns of the table `aircraft` of an evaluation."""
    return [
        {
            "callsign": each.callsign,
            "type": each.type,
            "route": " ".join(each.route),
            "entry_fl": each.fl,
            "exit_fl": each.exit_fl,
        }
        for each in scenario.aircraft
    ]


def _clearances(scenario: Scenario, flight: Flight) -> list[dict[str, Any]]:
    """The clearances as rows of an evaluation's table."""
    routes = {each.callsign: each.route for each in scenario.aircraft}
    return [
        row
        for cycle, each in flight.issued
        for row in clearance_rows(cycle, each, routes[each.callsign])
    ]


def _fly(path: Path, scenario: Scenario, platform: str, time_limit_s: float) -> Flight:
    """Fly in this process on our simulator, and in a separate process on others."""
    with scratch_folder("skystack-") as folder, error_context(str(path)):
        if platform == OWN:
            return fly_scenario(open_platform(platform, folder), scenario)
        (outcome,) = in_processes(partial(_open, platform), [scenario], folder, time_limit_s)
    if outcome.failed is not None:
        raise PlatformError(f"{path}: {platform}: {outcome.failed}")
    flight: Flight = outcome.result
    return flight


def _open(platform: str, folder: Path) -> Callable[[Scenario], Flight]:
    return partial(fly_scenario, open_platform(platform, folder))
