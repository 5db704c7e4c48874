"""The verb `simulate`: fly a scenario file and keep the trajectories."""

from pathlib import Path
from typing import Any

import pyarrow as pa
from rich.table import Table

from skystack.errors import InputError
from skystack.evaluation.tables import write_table
from skystack.simulator.scenario_file import fly, load_scenario, rows
from skystack.tasks.build import SECTORS


def simulate_file(path: Path, output: Path | None) -> dict[str, Any]:
    """Fly a scenario file; returns the last row of every aircraft.

    Writes all rows as Parquet where `output` is given (its folder must exist). Raises InputError
    for a scenario that cannot be flown or a file that cannot be written.
    """
    scenario = load_scenario(path, SECTORS)
    if output is not None and not output.parent.is_dir():
        raise InputError(f"{output}: the folder {output.parent} does not exist")
    columns = rows(scenario, fly(scenario))
    table = pa.table(columns)
    if output is not None:
        write_table(output, table, scenario.sector)
    last = table.slice(table.num_rows - len(scenario.aircraft)).to_pylist()
    return {
        "scenario": str(path),
        "rows": table.num_rows,
        "output": None if output is None else str(output),
        "final": last,
    }


def summary_table(summary: dict[str, Any]) -> Table:
    """Where everybody ended, for a terminal."""
    table = Table(title=f"{summary['scenario']}: {summary['rows']} rows")
    names = ("callsign", "time_s", "lat", "lon", "fl", "heading_deg", "ground_speed_kt")
    for name in names:
        table.add_column(name, justify="left" if name == "callsign" else "right")
    for row in summary["final"]:
        table.add_row(*(_shown(row[name]) for name in names))
    return table


def _shown(value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)
