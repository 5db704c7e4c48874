"""The verb `simulate`: fly a scenario file on a platform and keep the trajectories."""

import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
from rich.table import Table

from skystack.errors import InputError, PlatformError
from skystack.evaluation.flown_scenario import judge_flight
from skystack.evaluation.losses import Loss
from skystack.evaluation.stored import write_table
from skystack.evaluation.tables import STATUS
from skystack.files import check_folder_of
from skystack.platforms.flight import Flight, flight_rows, fly_scenario
from skystack.platforms.phraseology import written
from skystack.platforms.processes import TIME_LIMIT_S, in_processes
from skystack.platforms.registry import (
    OWN,
    check_platform,
    flown_type,
    open_platform,
    said_of,
)
from skystack.simulator.scenario_file import Scenario, load_scenario
from skystack.simulator.simulator import CYCLE_S


def simulate_file(
    path: Path, output: Path | None, platform: str = OWN, time_limit_s: float = TIME_LIMIT_S
) -> dict[str, Any]:
    """Fly a scenario file; returns the last row of every aircraft and what was said.

    Writes all rows as Parquet where `output` is given (its folder must exist). Raises InputError
    for a scenario that cannot be flown, a platform that is not there or a file that cannot be
    written; PlatformError when the platform fails.
    """
    check_platform(platform)
    scenario = load_scenario(path)
    if output is not None:
        check_folder_of(output)
    flight = _fly(path, scenario, platform, time_limit_s)
    judged = judge_flight(scenario, flight)
    status = pa.DictionaryArray.from_arrays(judged.status.reshape(-1), list(STATUS))
    table = pa.table(flight_rows(scenario, flight) | {"status": status})
    if output is not None:
        beside = {"aircraft": _aircraft(scenario), "clearances": _clearances(flight)}
        write_table(output, table, scenario.sector, scenario.performance, beside, scenario.fleet)
    return {
        "scenario": str(path),
        "platform": platform,
        "types": {one.callsign: flown_type(platform, one.type) for one in scenario.aircraft},
        "notes": said_of(platform, {one.type for one in scenario.aircraft}),
        "rows": table.num_rows,
        "output": None if output is None else str(output),
        "clearances": [
            {"cycle": cycle, "callsign": instruction.callsign, "text": written(instruction)}
            for cycle, instruction in flight.issued
        ],
        "losses_of_separation": [_loss(scenario, loss) for loss in judged.losses],
        "final": table.slice(table.num_rows - len(scenario.aircraft)).to_pylist(),
    }


def _loss(scenario: Scenario, loss: Loss) -> dict[str, Any]:
    first, second = (scenario.aircraft[number].callsign for number in (loss.first, loss.second))
    return {
        "first": first,
        "second": second,
        "from_s": loss.begins * CYCLE_S,
        "to_s": loss.ends * CYCLE_S,
        "least_nm": loss.least_nm,
    }


def loss_lines(summary: dict[str, Any]) -> list[str]:
    """The losses of separation, for a terminal: how many, then each."""
    found = summary["losses_of_separation"]
    lines = [f"losses of separation: {len(found)}"]
    for loss in found:
        least_nm = math.floor(loss["least_nm"] * 100.0) / 100.0  # 4.999 NM is not 5.00
        lines.append(
            f"  {loss['first']} and {loss['second']}: {loss['from_s']} to {loss['to_s']} s, "
            f"least {least_nm:.2f} NM"
        )
    return lines


def _aircraft(scenario: Scenario) -> list[dict[str, Any]]:
    """Who flies, with the columns of an evaluation's table of the same name."""
    return [
        {
            "callsign": one.callsign,
            "type": one.type,
            "route": " ".join(one.route),
            "entry_fl": one.fl,
            "exit_fl": one.exit_fl,
        }
        for one in scenario.aircraft
    ]


def _clearances(flight: Flight) -> list[dict[str, Any]]:
    """What was said, with the columns of an evaluation's table; a heading and a level are two."""
    rows = []
    for cycle, told in flight.issued:
        parts = (("heading", told.heading_deg, told.turn), ("level", told.level_fl, told.vertical))
        for kind, value, direction in parts:
            if value is not None:
                row = {"cycle": cycle, "callsign": told.callsign, "kind": kind, "value": value}
                rows.append(row | {"direction": direction, "instructions": 1})
                rows[-1]["text"] = written(told)
    return rows


def _fly(path: Path, scenario: Scenario, platform: str, time_limit_s: float) -> Flight:
    """The flight: ours in this process, another simulator's in one of its own."""
    with tempfile.TemporaryDirectory(prefix="skystack-") as folder:
        try:
            if platform == OWN:
                return fly_scenario(open_platform(platform, Path(folder)), scenario)
            work = partial(_flyer, platform)
            done = in_processes(work, [scenario], Path(folder), time_limit_s)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if done.failed:
        raise PlatformError(f"{path}: {platform}: {done.failed[0]}")
    flight: Flight = done.results[0]
    return flight


def _flyer(platform: str, folder: Path) -> Callable[[Scenario], Flight]:
    return partial(fly_scenario, open_platform(platform, folder))


def summary_table(summary: dict[str, Any]) -> Table:
    """Where everybody ended, for a terminal."""
    table = Table(title=f"{summary['scenario']}: {summary['rows']} rows")
    for name in _SHOWN:
        table.add_column(name.replace("_", " "), justify="left" if name == "callsign" else "right")
    for row in summary["final"]:
        table.add_row(*(f"{row[name]:{how}}" for name, how in _SHOWN.items()))
    return table


_SHOWN = {
    "callsign": "",
    "time_s": "d",
    "lat": ".4f",
    "lon": ".4f",
    "fl": ".1f",
    "heading_deg": ".1f",
    "ground_speed_kt": ".0f",
    "status": "",
}
"""Columns of the summary and how their values are written."""
