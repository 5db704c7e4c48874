"""Read and check Parquet tables with their sector; rebuild a flown scenario from them."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skystack.airspace.sector import LatLon, Sector
from skystack.airspace.sector_file import Point, SectorEntry, make_sector
from skystack.errors import MAX_INT, InputError, error_context
from skystack.evaluation.columns import (
    MAX_GROUP_BYTES,
    MAX_KEPT_ROWS,
    MAX_ROWS,
    TEXT,
    check_columns,
)
from skystack.evaluation.writing import (
    EVALUATION,
    FLEET,
    PERFORMANCE_MODEL,
    SCENARIOS,
    SECTOR,
    TRAFFIC,
    TrafficRecord,
)
from skystack.io.json_file import decode
from skystack.io.validation import convert
from skystack.platforms.registry import PLATFORMS, flown_type
from skystack.simulator.fleet import AircraftType, fleet
from skystack.simulator.limits import MAX_AIRCRAFT, MAX_TYPES
from skystack.simulator.performance import DEFAULT_TYPE, PERFORMANCE
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance, on_tick

MAX_STORED_CYCLES = 100_000
MAX_FLIGHTS = 5_000
"""The maximum number of flights in an hour of arriving traffic."""

Cycle = Annotated[int, msgspec.Meta(ge=0, le=MAX_STORED_CYCLES)]
Level = Annotated[float, msgspec.Meta(ge=-1000.0, le=1000.0)]

_Number = Annotated[int, msgspec.Meta(ge=0, le=MAX_INT)]
_Spans = list[tuple[_Number, _Number]]
_Types = Annotated[tuple[AircraftType, ...], msgspec.Meta(max_length=MAX_TYPES)]


def read_table(path: Path, columns: Sequence[str], filters: Any = None) -> pa.Table:
    """Some columns of a table, with texts dictionary-encoded: repeated texts take no memory.

    `filters` are pyarrow's, such as `[("scenario", "=", 3)]`. Raises InputError for a table that is
    missing, damaged or too large.
    """
    try:
        with path.open("rb") as file:  # pyarrow cannot open a path that is not UTF-8
            table = _read(path, file, columns, filters)
    except FileNotFoundError:
        raise InputError(f"{path}: missing (evaluation writes it)") from None
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: damaged: cannot be read as a Parquet table of an evaluation"
        ) from None
    with error_context(str(path)):
        check_columns(table)
    return _with_current_names(table)


_OLD_STATUS, _STATUS = "strayed", "excursion"
"""A value of the column `status` in older tables, and its current name."""


def _with_current_names(table: pa.Table) -> pa.Table:
    """The table with values of older versions replaced by their current names."""
    if "status" not in table.column_names:
        return table
    status = table["status"].cast(pa.string())
    renamed = pc.if_else(pc.equal(status, _OLD_STATUS), _STATUS, status).dictionary_encode()
    return table.set_column(table.column_names.index("status"), "status", renamed)


def _read(path: Path, file: BinaryIO, columns: Sequence[str], filters: Any) -> pa.Table:
    """Read the table in batches, so that rows that are not requested take no memory."""
    condition = None if filters is None else pq.filters_to_expression(filters)
    filtered = [] if filters is None else [name for name, _, _ in filters]
    needed = list(dict.fromkeys([*columns, *filtered]))
    head = pq.read_metadata(file)
    groups = _groups(path, head, filters or [])
    _check_head(path, head, needed, groups)
    texts = sorted(TEXT & set(needed))
    # Without pre-buffering, no thread of pyarrow can still hold the file when Python ends.
    with pq.ParquetFile(file, metadata=head, read_dictionary=texts, pre_buffer=False) as parquet:
        empty = parquet.schema_arrow.empty_table().select(needed)
        parts, rows = [empty], 0
        for batch in parquet.iter_batches(
            _BATCH, row_groups=groups, columns=needed, use_threads=False
        ):
            part = pa.Table.from_batches([batch])
            parts.append(part if condition is None else part.filter(condition))
            rows += parts[-1].num_rows
            if rows > MAX_KEPT_ROWS:
                raise InputError(
                    f"{path}: is too large to be read at once (allowed: {MAX_KEPT_ROWS} rows "
                    "after filtering)"
                )
    table = pa.concat_tables(parts).select(list(columns))
    # The schema lacks the metadata that was added to the file when it was completed.
    return table.replace_schema_metadata({**(head.metadata or {}), **(empty.schema.metadata or {})})


def _groups(path: Path, head: Any, filters: Sequence[tuple[str, str, Any]]) -> list[int]:
    """The row groups that may hold the requested scenarios, from the index in the metadata."""
    data = (head.metadata or {}).get(SCENARIOS)
    requested = [values for name, how, values in filters if (name, how) == ("scenario", "in")]
    requested += [[value] for name, how, value in filters if (name, how) == ("scenario", "=")]
    groups = list(range(head.num_row_groups))
    if data is None or not requested:
        return groups
    spans = decode(data, _Spans, f"{path}: the scenarios in its metadata")
    if len(spans) != len(groups):
        raise InputError(f"{path}: damaged: the scenarios in its metadata do not match the table")
    numbers = np.unique(requested[0])
    first, last = np.array(spans, dtype=np.int64).reshape(-1, 2).T
    before, until = np.searchsorted(numbers, first), np.searchsorted(numbers, last, side="right")
    found: list[int] = np.flatnonzero(before < until).tolist()
    return found


_BATCH = 65536
"""The number of rows read at once."""


def has_column(path: Path, name: str) -> bool:
    """Whether a table has a column. Raises InputError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return name in pq.read_schema(file).names
    except (OSError, pa.ArrowException, UnicodeDecodeError):
        raise InputError(f"{path}: missing or damaged: not a Parquet table") from None


def rows_of(callsign: str, table: pa.Table) -> pa.Table:
    """The rows of one aircraft."""
    return table.filter(pc.equal(table["callsign"].cast(pa.string()), callsign))


def _check_head(path: Path, head: Any, columns: Sequence[str], groups: Sequence[int]) -> None:
    """Before reading, check that each column exists exactly once and that the size is allowed."""
    known = head.schema.to_arrow_schema().names
    for name in columns:
        if known.count(name) != 1:
            problem = f"has no column {name!r}" if name not in known else f"has {name!r} twice"
            raise InputError(f"{path}: {problem} (found: {', '.join(known)})")
    # The metadata of single columns is not read: pyarrow aborts the process if it is damaged.
    requested = [head.row_group(number) for number in groups]
    rows = sum(group.num_rows for group in requested)
    size = max((group.total_byte_size for group in requested), default=0)
    if rows > MAX_ROWS or size > MAX_GROUP_BYTES:
        raise InputError(
            f"{path}: is too large: {rows} rows to read, {size} bytes in a row group "
            f"(allowed: {MAX_ROWS} rows, {MAX_GROUP_BYTES} bytes)"
        )


def sector_of(path: Path, table: pa.Table) -> Sector:
    """The sector in a table's metadata. Raises InputError if there is none."""
    data = (table.schema.metadata or {}).get(SECTOR)
    if data is None:
        raise InputError(f"{path}: has no sector in its metadata")
    with error_context(f"{path}: the sector in its metadata"):
        return _stored_sector(data)


def traffic_of(path: Path, table: pa.Table) -> TrafficRecord | None:
    """The arriving traffic in a table's metadata, if the scenarios are hours of it."""
    data = (table.schema.metadata or {}).get(TRAFFIC)
    if data is None:
        return None
    found: TrafficRecord = decode(data, TrafficRecord, f"{path}: the traffic in its metadata")
    return found


@lru_cache(maxsize=16)
def _stored_sector(data: bytes) -> Sector:
    """The checked sector. Cached, because the check takes longer than reading a table."""
    stored = decode(data, Sector, "JSON")
    ring = [[lon, lat] for lat, lon in stored.area]
    return make_sector(
        SectorEntry(
            name=stored.name,
            levels_fl=stored.levels_fl,
            area={"type": "Polygon", "coordinates": [ring]},
            fixes={name: _point(f"fixes.{name}", at) for name, at in stored.fixes.items()},
            routes=stored.routes,
            origin=_point("origin", stored.origin),
            separation_nm=stored.separation_nm,
            separation_fl=stored.separation_fl,
        )
    )


def _point(where: str, at: LatLon) -> Point:
    """A point with checked coordinates, as the metadata is untrusted."""
    lat, lon = at
    with error_context(where, "."):
        point: Point = convert({"lat": lat, "lon": lon}, Point)
    return point


class _AircraftRow(msgspec.Struct):
    callsign: str
    type: str
    route: str
    entry_fl: Level
    exit_fl: int


class _ClearanceRow(msgspec.Struct):
    cycle: Cycle
    callsign: str
    kind: str
    value: Cycle
    direction: str | None
    instructions: int
    text: str


_EMBEDDED: dict[str, Any] = {"aircraft": list[_AircraftRow], "clearances": list[_ClearanceRow]}


def metadata_of(path: Path, table: pa.Table, key: str) -> list[dict[str, Any]]:
    """A small table in a table's metadata, by its key. Raises InputError if there is none."""
    data = (table.schema.metadata or {}).get(key.encode())
    if data is None:
        raise InputError(f"{path}: has no {key} in its metadata (simulate writes them)")
    rows: list[msgspec.Struct] = decode(data, _EMBEDDED[key], f"{path}: the {key} in its metadata")
    return [msgspec.to_builtins(row) for row in rows]


def check_aircraft(
    path: Path, sector: Sector, aircraft: Sequence[Mapping[str, Any]], most: int = MAX_AIRCRAFT
) -> None:
    """Check the aircraft of one scenario: no duplicates, no unknown fixes.

    Raises InputError that names the aircraft.
    """
    if len(aircraft) > most:
        raise InputError(f"{path}: has {len(aircraft)} aircraft (allowed: {most})")
    signs = Counter(row["callsign"] for row in aircraft)
    for row in aircraft:
        if signs[row["callsign"]] > 1:
            raise InputError(f"{path}: {row['callsign']} appears twice in one scenario")
        for fix in row["route"].split():
            if fix not in sector.fixes:
                raise InputError(
                    f"{path}: the route of {row['callsign']} has an unknown fix {fix!r}"
                )


def stored_scenario(folder: Path, number: int) -> Scenario:
    """A scenario of an evaluation with its issued clearances, ready to be flown again.

    Raises InputError that names a missing or damaged table, or a scenario that does not exist.
    """
    only = [("scenario", "=", number)]
    path = folder / "trajectories.parquet"
    start = read_table(
        path, ("callsign", "lat", "lon", "fl", "heading_deg"), [*only, ("cycle", "=", 0)]
    )
    if traffic_of(path, start) is not None:
        raise InputError(f"{folder}: hours of arriving traffic cannot be flown again as a scenario")
    if not start.num_rows:
        raise InputError(f"{folder}: has no scenario {number}")
    columns = ("callsign", "type", "route", "exit_fl", "own_navigation")
    aircraft = read_table(folder / "aircraft.parquet", columns, only)
    issued = read_table(folder / "clearances.parquet", ("cycle", "callsign", "kind", "value"), only)
    episodes = read_table(folder / "episodes.parquet", ("cycles", "clearances"), only)
    check_same_evaluation(folder, (start, aircraft, issued, episodes))
    performance, types = _performance_of(path, start)
    starts = {row.pop("callsign"): row for row in start.to_pylist()}
    counts = episodes["clearances"].to_pylist()
    if counts != [issued.num_rows] or set(starts) != set(aircraft["callsign"].to_pylist()):
        raise tables_disagree(folder, number)
    sector = sector_of(path, start)
    aircraft_rows, clearances = aircraft.to_pylist(), issued.to_pylist()
    check_aircraft(folder / "aircraft.parquet", sector, aircraft_rows)
    cycles = episodes["cycles"][0].as_py()
    if not 1 <= cycles <= MAX_STORED_CYCLES:
        allowed = f"1 to {MAX_STORED_CYCLES}"
        raise InputError(f"{folder}: scenario {number} has {cycles} cycles ({allowed})")
    for row in clearances:
        _check_clearance(folder / "clearances.parquet", row, cycles, starts)
    return Scenario(
        sector,
        performance,
        cycles,
        tuple(_aircraft(row, starts[row["callsign"]], types) for row in aircraft_rows),
        tuple(_clearance(row) for row in clearances),
        types,
    )


def check_same_evaluation(folder: Path, tables: Iterable[pa.Table]) -> None:
    """Raise InputError for tables of different evaluations. Older tables have no digest."""
    digests = {(table.schema.metadata or {}).get(EVALUATION) for table in tables} - {None}
    if len(digests) > 1:
        raise InputError(f"{folder}: its tables are from different evaluations")


def tables_disagree(folder: Path, number: int) -> InputError:
    """The error for tables that were not all written by the same evaluation."""
    return InputError(f"{folder}: its tables do not agree on scenario {number}")


def _performance_of(path: Path, table: pa.Table) -> tuple[str, tuple[AircraftType, ...]]:
    """The performance model (default: `table`) and the fleet in a table's metadata."""
    metadata = table.schema.metadata or {}
    performance = metadata.get(PERFORMANCE_MODEL, b"table").decode("utf-8", "replace")
    if performance not in PERFORMANCE:
        raise InputError(f"{path}: unknown performance {performance!r} in its metadata")
    types: tuple[AircraftType, ...] = ()
    if FLEET in metadata:
        types = decode(metadata[FLEET], _Types, f"{path}: the fleet in its metadata")
        with error_context(f"{path}: its metadata"):
            fleet(types, "fleet")
    return performance, types


def _planned_type(flown: str, types: Sequence[AircraftType]) -> str:
    """The type in the scenario, from the type that the platform flew, which is in the table."""
    known = [each.type for each in types] or [DEFAULT_TYPE]
    if flown in known:
        return flown
    planned = (each for each in known if flown in {flown_type(name, each) for name in PLATFORMS})
    return next(planned, flown)


def _check_clearance(
    path: Path, row: Mapping[str, Any], cycles: int, callsigns: Collection[str]
) -> None:
    """Raise InputError for an unknown callsign, a cycle after the end, or an invalid value."""
    most = {"heading": 360, "level": 600}.get(row["kind"], -1)
    if row["callsign"] not in callsigns or row["cycle"] >= cycles or row["value"] > most:
        values = ", ".join(str(each) for each in row.values())
        raise InputError(f"{path}: not a clearance of this scenario: {values}")


def _aircraft(
    row: dict[str, Any], start: dict[str, float], types: Sequence[AircraftType]
) -> Aircraft:
    return Aircraft(
        **start | {"fl": on_tick(start["fl"])},
        callsign=row["callsign"],
        type=_planned_type(row["type"], types),
        route=tuple(row["route"].split()),
        exit_fl=row["exit_fl"],
        own_navigation=row["own_navigation"],
    )


def _clearance(row: dict[str, Any]) -> ScheduledClearance:
    level = row["kind"] == "level"
    return ScheduledClearance(
        row["cycle"],
        row["callsign"],
        heading_deg=None if level else row["value"],
        fl=row["value"] if level else None,
    )
