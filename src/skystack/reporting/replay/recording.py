"""Recorded scenarios: the rows of all aircraft, the clearances and the losses of separation.

They are read from the folder of an evaluation, or from a file that `skystack simulate` wrote.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from skystack.airspace.sector import Sector
from skystack.errors import InputError, exists, printable
from skystack.evaluation.losses import FlightPath, Loss, losses
from skystack.evaluation.stored import (
    MAX_FLIGHTS,
    MAX_STORED_CYCLES,
    check_aircraft,
    check_same_evaluation,
    has_column,
    metadata_of,
    read_table,
    rows_of,
    sector_of,
    tables_disagree,
    traffic_of,
)
from skystack.evaluation.writing import TrafficRecord
from skystack.platforms.registry import OWN
from skystack.reporting.hour_table import traffic_in_words
from skystack.reporting.replay.outcome import (
    CRITERIA,
    Failure,
    Flown,
    counts_clearances,
    failures_of,
)
from skystack.simulator.limits import MAX_AIRCRAFT

SCENARIOS, HOURS = 100, 5
"""The default numbers of scenarios and of hours of arriving traffic in a replay."""
NUMBERS = (
    *("lat", "lon", "fl", "heading_deg", "cleared_heading_deg", "cleared_fl"),
    *("ground_speed_kt", "vertical_speed_ft_min"),
)
"""The columns of the trajectories that are drawn."""
OPTIONAL = ("exit_offset_nm", "birth_cycle", "correct_exit")
"""Columns of the aircraft that only some tables have."""
CLEARANCE = ("callsign", "cycle", "kind", "value", "direction", "instructions", "text")
FLYING = "in_sector"


class RecordedClearance(NamedTuple):
    """A clearance that was issued after cycle `cycle`, before the next one was flown."""

    aircraft: int
    """The index of the addressed aircraft in the scenario."""
    cycle: int
    kind: str
    """`heading`, `direct` or `level`."""
    value: int
    """The heading, the level, or the index in the route of a fix."""
    direction: str | None
    instructions: int
    """The number of instructions stacked into it."""
    text: str


@dataclass(frozen=True)
class RecordedAircraft:
    """One aircraft, from the row in which it appears to that in which it has exited, if it does.

    Its arrays have one value for each of these rows.
    """

    callsign: str
    type: str
    route: tuple[str, ...]
    entry_fl: float
    exit_fl: int
    position_nm: Float[np.ndarray, "rows 2"]
    """In the sector's plane."""
    fl: Float[np.ndarray, " rows"]
    heading_deg: Float[np.ndarray, " rows"]
    cleared_heading_deg: Float[np.ndarray, " rows"]
    cleared_fl: Float[np.ndarray, " rows"]
    ground_speed_kt: Float[np.ndarray, " rows"]
    vertical_speed_ft_min: Float[np.ndarray, " rows"]
    status: tuple[str, ...]
    """One per row, as in the tables."""
    exit_offset_nm: float | None = None
    """The distance from its exit fix at the exit; None if it does not exit or is not recorded."""
    begins: int = 0
    """The row in which it appears; above 0 only for arriving traffic."""
    correct_exit: bool | None = None
    """Whether it left through its exit at its exit level; None if the tables do not say."""

    @property
    def ends(self) -> int:
        """The row after its last one."""
        return self.begins + len(self.fl)

    def flies_at(self, row: int) -> bool:
        return self.begins <= row < self.ends


@dataclass(frozen=True)
class ReplayScenario:
    """One scenario as it was flown."""

    number: int
    cycles: int
    success: bool | None
    """None if the scenario was not evaluated, or is an hour of arriving traffic."""
    aircraft: tuple[RecordedAircraft, ...]
    clearances: tuple[RecordedClearance, ...]
    losses: tuple[Loss, ...]
    failures: tuple[Failure, ...] = ()
    """Why it did not succeed; for an hour of arriving traffic, its excursions and exits at a wrong
    level. Empty if there are none, or if the tables do not say."""

    @property
    def has_arrivals(self) -> bool:
        return any(each.begins for each in self.aircraft)

    @property
    def transmissions(self) -> list[RecordedClearance]:
        """The clearances, without the second element of those with a heading and a level."""
        first: dict[tuple[int, int], RecordedClearance] = {}
        for each in self.clearances:
            first.setdefault((each.cycle, each.aircraft), each)
        return list(first.values())


@dataclass(frozen=True)
class Replay:
    """The scenarios of one evaluation or one file, all in one sector."""

    title: str
    sector: Sector
    scenarios: tuple[ReplayScenario, ...]
    traffic: TrafficRecord | None = None
    """The arriving traffic, if the scenarios are hours of it."""


def read_replay(path: Path, scenarios: int | None = None, only: int | None = None) -> Replay:
    """Read an evaluation's first scenarios, or the scenario in a `.parquet` file of `simulate`.

    `scenarios` is their number: by default `SCENARIOS`, or `HOURS` hours of arriving traffic.
    `only` selects a single scenario by its number instead. `path` may also be a folder that
    contains exactly one evaluation. Raises InputError that names a missing or damaged table, a
    missing scenario, or the evaluations to choose from.
    """
    if path.is_dir():
        return _evaluation(_evaluation_in(path), scenarios, only)
    if not exists(path):
        raise InputError(
            f"{path}: does not exist (allowed: the folder of an evaluation, or a .parquet file "
            "of simulate)"
        )
    return _simulated(path)


def _evaluation_in(path: Path) -> Path:
    if exists(path / "trajectories.parquet") or exists(path / "episodes.parquet"):
        return path
    found = sorted(
        {
            table.parent
            for depth in ("*", "evaluation/*")
            for table in path.glob(f"{depth}/episodes.parquet")
        }
    )
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            f"{path}: contains no evaluation (written by evaluate --out and reproduce)"
        )
    names = ", ".join(str(folder.relative_to(path)) for folder in found)
    raise InputError(f"{path}: contains {len(found)} evaluations: choose one or two of {names}")


def _evaluation(folder: Path, count: int | None, number: int | None) -> Replay:
    episodes = _episodes(folder, count, number)
    only = [("scenario", "in", episodes["scenario"].to_pylist())]
    path = folder / "trajectories.parquet"
    flown = read_table(path, ("scenario", "cycle", "callsign", "status", *NUMBERS), only)
    columns = ("scenario", "callsign", "type", "route", "entry_fl", "exit_fl")
    entries = _with_optional(folder / "aircraft.parquet", columns, OPTIONAL, only)
    issued = read_table(folder / "clearances.parquet", ("scenario", *CLEARANCE), only)
    check_same_evaluation(folder, (episodes, flown, entries, issued))
    sector = sector_of(path, flown)
    rows, aircraft, clearances = (_by_scenario(table) for table in (flown, entries, issued))
    outcomes = episodes.to_pylist()
    counted = counts_clearances(outcomes)
    traffic = traffic_of(path, flown)
    return Replay(
        _title(folder) if traffic is None else _title_of_hours(traffic),
        sector,
        tuple(
            _scenario(sector, path, row, rows, aircraft, clearances, counted) for row in outcomes
        ),
        traffic,
    )


def _with_optional(
    path: Path, columns: tuple[str, ...], optional: tuple[str, ...], only: Any
) -> pa.Table:
    """Read columns, and those of the optional ones that the table has: older ones lack some."""
    table = read_table(path, columns, only)
    found = tuple(name for name in optional if has_column(path, name))
    return read_table(path, (*columns, *found), only) if found else table


def _episodes(folder: Path, count: int | None, number: int | None) -> pa.Table:
    """The rows of the first scenarios, or of one."""
    path, columns = folder / "episodes.parquet", ("scenario", "cycles", "clearances")
    one = None if number is None else [("scenario", "=", number)]
    episodes = read_table(path, columns, one)
    if traffic_of(path, episodes) is not None:
        count = HOURS if count is None else count
    else:  # hours of arriving traffic have no criteria
        known = (name for name in CRITERIA if has_column(path, name))
        episodes = read_table(path, (*columns, "success", *known), one)
    episodes = episodes.sort_by("scenario").slice(0, SCENARIOS if count is None else count)
    if not episodes.num_rows:
        known = read_table(path, ("scenario",))["scenario"].to_numpy()
        if not len(known):
            raise InputError(f"{folder}: contains no scenario")
        found = f"(found: {known.min()} to {known.max()})"
        raise InputError(f"{_title(folder)} has no scenario {number} {found}")
    return episodes


def _title(folder: Path) -> str:
    """`lateral-tuned, stacked` for `lateral-tuned-s0-skystack-stacked`; else the folder's name."""
    name = printable(folder.name)
    found = re.fullmatch(r"(.+)-s\d+-(\w+)-(stacked|plain)", name)
    if found is None:
        return name
    experiment, platform, kind = found.groups()
    how = "stacked" if kind == "stacked" else "unstacked"
    return f"{experiment}, {how}" + (f", {platform}" if platform != OWN else "")


def _title_of_hours(traffic: TrafficRecord) -> str:
    """`sector-control, 120 flights/h`."""
    what = traffic_in_words(traffic.traffic, "{} traffic")
    net = ", no safety net" if traffic.safety_net is False else ""
    uncertainty = ", uncertainty" if traffic.uncertainty else ""
    where = "" if traffic.platform == OWN else f", in {traffic.platform}"
    return printable(f"{traffic.agent}{net}, {what}{uncertainty}{where}")


_NO_ROWS = pa.table({})


def _scenario(
    sector: Sector,
    path: Path,
    episode: Mapping[str, Any],
    rows: Mapping[int, pa.Table],
    aircraft: Mapping[int, pa.Table],
    clearances: Mapping[int, pa.Table],
    counted: bool,
) -> ReplayScenario:
    number = episode["scenario"]
    has_arrivals = "success" not in episode
    if not has_arrivals and (number not in rows or number not in aircraft):
        raise tables_disagree(path.parent, number)
    entries = aircraft[number].to_pylist() if number in aircraft else []
    flown_rows = rows.get(number, _NO_ROWS)
    most = MAX_FLIGHTS if has_arrivals else MAX_AIRCRAFT
    check_aircraft(path.parent / "aircraft.parquet", sector, entries, most)
    issued = clearances[number].to_pylist() if number in clearances else []
    flying = tuple(_aircraft(sector, path, flown_rows, each) for each in entries)
    cycles = episode["cycles"]
    if cycles > MAX_STORED_CYCLES:
        raise tables_disagree(path.parent, number)
    if any(each.ends > cycles + 1 for each in flying):
        raise tables_disagree(path.parent, number)
    flown = _assemble(sector, number, cycles, episode.get("success"), flying, issued, path)
    addressed = [each.aircraft for each in flown.clearances]
    known = [
        Flown(
            each.status,
            float(each.fl[-1]),
            each.exit_fl,
            addressed.count(index),
            each.correct_exit,
        )
        for index, each in enumerate(flying)
    ]
    flown = replace(flown, failures=failures_of(episode, known, counted))
    has_all_rows = (
        sum(len(each.fl) for each in flying) == len(flown_rows)
        if has_arrivals
        else len(entries) * (cycles + 1) == len(flown_rows)
    )
    if len(issued) != episode["clearances"] or not has_all_rows:
        raise tables_disagree(path.parent, number)
    return flown


def _simulated(path: Path) -> Replay:
    has_status = has_column(path, "status")  # older tables have none
    flown = read_table(path, ("cycle", "callsign", *NUMBERS, *(("status",) if has_status else ())))
    entries, issued = (metadata_of(path, flown, key) for key in ("aircraft", "clearances"))
    sector = sector_of(path, flown)
    check_aircraft(path, sector, entries)
    if not flown.num_rows:
        raise InputError(f"{path}: contains no row")
    if not has_status:
        flown = flown.append_column("status", pa.array([FLYING] * flown.num_rows))
    flying = tuple(_aircraft(sector, path, flown, each) for each in entries)
    cycles = int(flown["cycle"].to_numpy().max())
    scenario = _assemble(sector, 0, cycles, None, flying, issued, path)
    return Replay(printable(path.stem), sector, (scenario,))


def _aircraft(
    sector: Sector, path: Path, rows: pa.Table, entry: Mapping[str, Any]
) -> RecordedAircraft:
    callsign = entry["callsign"]
    own = rows_of(callsign, rows).sort_by("cycle")
    begins = entry.get("birth_cycle", 0)
    if not own.num_rows or own["cycle"].to_pylist() != list(range(begins, begins + own.num_rows)):
        raise InputError(f"{path}: the rows of {callsign} are not complete")
    status = own["status"].to_pylist()
    end = status.index("exited") + 1 if "exited" in status else len(status)
    columns = {name: own[name].to_numpy().astype(np.float64)[:end] for name in NUMBERS}
    return RecordedAircraft(
        callsign=callsign,
        type=entry["type"],
        route=tuple(entry["route"].split()),
        entry_fl=float(entry["entry_fl"]),
        exit_fl=entry["exit_fl"],
        exit_offset_nm=entry.get("exit_offset_nm"),
        begins=begins,
        correct_exit=entry.get("correct_exit"),
        position_nm=sector.plane.to_plane(columns.pop("lat"), columns.pop("lon")),
        status=tuple(status[:end]),
        **columns,
    )


def _assemble(
    sector: Sector,
    number: int,
    cycles: int,
    success: bool | None,
    aircraft: tuple[RecordedAircraft, ...],
    issued: list[dict[str, Any]],
    path: Path,
) -> ReplayScenario:
    index = {each.callsign: place for place, each in enumerate(aircraft)}
    for row in issued:
        if row["callsign"] not in index:
            raise InputError(f"{path}: a clearance is for {row['callsign']!r}, which does not fly")
    clearances = (
        RecordedClearance(index[row["callsign"]], *(row[name] for name in CLEARANCE[1:]))
        for row in issued
    )
    paths = [FlightPath(each.position_nm, each.fl, each.begins) for each in aircraft]
    lost = tuple(losses(sector, paths))
    in_order = tuple(sorted(clearances, key=lambda each: each.cycle))
    return ReplayScenario(number, cycles, success, aircraft, in_order, lost)


def _by_scenario(table: pa.Table) -> dict[int, pa.Table]:
    """The table, split by scenario."""
    if not table.num_rows:
        return {}
    table = table.sort_by("scenario")
    number = table["scenario"].to_numpy()
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    ends = np.append(starts[1:], len(number))
    return {
        int(number[start]): table.slice(start, end - start)
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
    }


def as_json(value: Any) -> str:
    """JSON that is safe inside a script element, as it contains no `<`."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
