"""Parquet tables that carry their sector: written, read and checked; a flown scenario from them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.files import write_aside
from skystack.simulator.performance import PERFORMANCE
from skystack.simulator.scenario_file import Aircraft, GivenClearance, Scenario

_SECTOR, _PERFORMANCE = b"sector", b"performance"


def write_table(
    path: Path,
    table: pa.Table,
    sector: Sector,
    performance: str,
    beside: Mapping[str, list[dict[str, Any]]] | None = None,
) -> None:
    """Write one table as Parquet, its sector and the name of the performance in the metadata.

    `beside` are small tables that go along in the metadata as JSON. Raises InputError if it cannot
    be written.
    """
    sink = pa.BufferOutputStream()
    metadata = {_SECTOR: msgspec.json.encode(sector), _PERFORMANCE: performance.encode()}
    metadata |= {key.encode(): msgspec.json.encode(rows) for key, rows in (beside or {}).items()}
    pq.write_table(table.replace_schema_metadata(metadata), sink, compression="zstd")
    write_aside(path, sink.getvalue().to_pybytes())


def read_table(path: Path, columns: Sequence[str], filters: Any = None) -> pa.Table:
    """Some columns of a table. Raises InputError that names a missing or damaged table."""
    try:
        known = pq.read_schema(path).names
        missing = [name for name in columns if name not in known]
        if missing:
            raise InputError(f"{path}: has no column {missing[0]!r} (found: {', '.join(known)})")
        return pq.read_table(path, columns=list(columns), filters=filters)
    except FileNotFoundError:
        raise InputError(f"{path}: missing (evaluation writes it)") from None
    except (OSError, pa.ArrowException):
        raise InputError(
            f"{path}: damaged: cannot be read as a Parquet table of an evaluation"
        ) from None


def sector_of(path: Path, table: pa.Table) -> Sector:
    """The sector in a table's metadata. Raises InputError where there is none."""
    data = (table.schema.metadata or {}).get(_SECTOR)
    if data is None:
        raise InputError(f"{path}: has no sector in its metadata")
    try:
        return msgspec.json.decode(data, type=Sector)
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: the sector in its metadata is damaged: {error}") from None


def metadata_of(path: Path, table: pa.Table, key: str) -> list[dict[str, Any]]:
    """A small table in a table's metadata. Raises InputError where there is none."""
    data = (table.schema.metadata or {}).get(key.encode())
    if data is None:
        raise InputError(f"{path}: has no {key} in its metadata (simulate writes them)")
    try:
        return msgspec.json.decode(data, type=list[dict[str, Any]])
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: the {key} in its metadata are damaged: {error}") from None


def stored_scenario(folder: Path, number: int) -> Scenario:
    """A scenario of an evaluation with the clearances that were issued in it, to be flown again.

    Raises InputError that names a missing or damaged table, or the scenario that is not there.
    """
    only = [("scenario", "=", number)]
    path = folder / "trajectories.parquet"
    start = read_table(
        path, ("callsign", "lat", "lon", "fl", "heading_deg"), [*only, ("cycle", "=", 0)]
    )
    if not start.num_rows:
        raise InputError(f"{folder}: has no scenario {number}")
    columns = ("callsign", "type", "route", "exit_fl", "own_navigation")
    aircraft = read_table(folder / "aircraft.parquet", columns, only)
    issued = read_table(folder / "clearances.parquet", ("cycle", "callsign", "kind", "value"), only)
    episodes = read_table(folder / "episodes.parquet", ("cycles",), only)
    performance = (start.schema.metadata or {}).get(_PERFORMANCE, b"table").decode()
    if performance not in PERFORMANCE:
        raise InputError(f"{path}: unknown performance {performance!r} in its metadata")
    flown = {row.pop("callsign"): row for row in start.to_pylist()}
    if episodes.num_rows != 1 or set(flown) != set(aircraft["callsign"].to_pylist()):
        raise InputError(f"{folder}: its tables do not agree on scenario {number}")
    return Scenario(
        sector_of(path, start),
        performance,
        episodes["cycles"][0].as_py(),
        tuple(_aircraft(row, flown[row["callsign"]]) for row in aircraft.to_pylist()),
        tuple(_given(row) for row in issued.to_pylist()),
    )


def _aircraft(row: dict[str, Any], start: dict[str, float]) -> Aircraft:
    return Aircraft(
        **start,
        callsign=row["callsign"],
        type=row["type"],
        route=tuple(row["route"].split()),
        exit_fl=row["exit_fl"],
        own_navigation=row["own_navigation"],
    )


def _given(row: dict[str, Any]) -> GivenClearance:
    level = row["kind"] == "level"
    return GivenClearance(
        row["cycle"],
        row["callsign"],
        heading_deg=None if level else row["value"],
        fl=row["value"] if level else None,
    )
