"""Read an evaluation's Parquet tables: the outcomes of all scenarios, or one scenario to draw."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from skystack.airspace.sector import Sector
from skystack.errors import InputError, error_context
from skystack.evaluation.stored import check_aircraft, read_table, rows_of, sector_of

BURST_GAP_CYCLES = 2
"""The longest gap in a burst: of two aircraft, each may receive only every other instruction."""

SAMPLES_PER_CYCLE = 60
"""Ten per second, at which two aircraft that meet head-on come 0.026 NM closer per sample."""


class IssuedClearance(NamedTuple):
    """A clearance and its time of issue."""

    cycle: int
    time_s: int
    kind: str
    value: int
    direction: str | None
    """None if the aircraft already flies the value."""
    instructions: int
    text: str

    @property
    def short(self) -> str:
        """Format as `right 215`, `climb FL340`, or `fly 215` if no turn is needed."""
        return f"{self.direction or 'fly'} {self.target}"

    def continues_earlier(self, before: "IssuedClearance") -> bool:
        """Whether this continues an earlier clearance: in the same direction, and soon after."""
        change = self.value - before.value
        forward = change % 360 < 180 if self.kind == "heading" else change > 0
        return (
            (self.kind, self.direction) == (before.kind, before.direction)
            and forward == (self.direction in {"right", "climb"})
            and self.cycle - before.cycle <= BURST_GAP_CYCLES
        )

    @property
    def target(self) -> str:
        """The cleared heading in three digits, or the cleared level."""
        return f"FL{self.value}" if self.kind == "level" else f"{self.value:03d}"


@dataclass(frozen=True)
class Track:
    """One aircraft in one scenario, from the start to its exit or to the end of the scenario."""

    callsign: str
    route_nm: Float[np.ndarray, "points 2"]
    position_nm: Float[np.ndarray, "rows 2"]
    """One row per cycle, from cycle 0, in the sector's plane."""
    level_fl: Float[np.ndarray, " rows"]
    cleared_fl: Float[np.ndarray, " rows"]
    exit_fl: int
    excursion_cycle: int | None
    clearances: tuple[IssuedClearance, ...]

    @property
    def bursts(self) -> list[list[IssuedClearance]]:
        """The clearances grouped into bursts: soon after each other, in the same direction."""
        runs: list[list[IssuedClearance]] = [[first] for first in self.clearances[:1]]
        for before, after in pairwise(self.clearances):
            if after.continues_earlier(before):
                runs[-1].append(after)
            else:
                runs.append([after])
        return runs


class Approach(NamedTuple):
    """The closest approach of two aircraft."""

    distance_nm: float
    position_nm: Float[np.ndarray, "2 2"]
    """One row per aircraft."""


@dataclass(frozen=True)
class FlownScenario:
    """One scenario as it was flown."""

    sector: Sector
    number: int
    clearances: int
    tracks: tuple[Track, ...]

    @property
    def least_separation(self) -> Approach | None:
        """The closest approach of aircraft without vertical separation; None if there is none."""
        pairs = [
            _closest_approach(self.sector, first, second)
            for first, second in combinations(self.tracks, 2)
        ]
        near = [approach for approach in pairs if approach is not None]
        return min(near, key=lambda approach: approach.distance_nm, default=None)


def _closest_approach(sector: Sector, first: Track, second: Track) -> Approach | None:
    """The closest approach, with straight motion assumed between radar positions."""
    rows = min(len(first.position_nm), len(second.position_nm))
    cycle = np.arange(rows, dtype=np.float64)
    time = np.linspace(0.0, rows - 1.0, (rows - 1) * SAMPLES_PER_CYCLE + 1)

    def at_time(values: Float[np.ndarray, " _"]) -> Float[np.ndarray, " samples"]:
        return np.interp(time, cycle, values[:rows])

    position_nm = np.array(
        [[at_time(axis) for axis in track.position_nm.T] for track in (first, second)]
    )
    level_apart_fl = np.abs(at_time(first.level_fl) - at_time(second.level_fl))
    apart_nm = np.hypot(*(position_nm[0] - position_nm[1]))
    apart_nm /= sector.plane.scale(position_nm[:, 1].mean(axis=0))
    apart_nm = np.where(level_apart_fl < sector.separation_fl, apart_nm, np.inf)
    nearest = int(np.argmin(apart_nm))
    if not np.isfinite(apart_nm[nearest]):
        return None
    return Approach(float(apart_nm[nearest]), position_nm[:, :, nearest])


class Outcomes(NamedTuple):
    """The results of an evaluation's first scenarios."""

    scenario: Int[np.ndarray, " scenarios"]
    clearances: Int[np.ndarray, " scenarios"]
    success: np.ndarray
    min_separation_nm: np.ndarray
    """Infinite if all aircraft were always vertically separated."""
    loss_of_separation: np.ndarray


class Start(NamedTuple):
    """The routes and level changes planned in one scenario."""

    routes: tuple[tuple[str, ...], ...]
    climbs_fl: tuple[int, ...]
    """Exit level minus entry level, negative for descents."""

    @property
    def reciprocal(self) -> bool:
        """Whether one aircraft's route is the reverse of another's."""
        return any(first == second[::-1] for first, second in combinations(self.routes, 2))


def read_starts(folder: Path, numbers: Sequence[int]) -> list[Start]:
    """Read the starts of scenarios. Raises InputError that names a missing or damaged table."""
    path = folder / "aircraft.parquet"
    only = [("scenario", "in", list(numbers))]
    table = read_table(path, ("scenario", "route", "entry_fl", "exit_fl"), only)
    aircraft: dict[int, list[dict[str, Any]]] = {number: [] for number in numbers}
    for row in table.to_pylist():
        aircraft[row["scenario"]].append(row)
    for number, rows in aircraft.items():
        if not rows:
            raise InputError(f"{path}: has no scenario {number}")
    return [
        Start(
            tuple(tuple(row["route"].split()) for row in rows),
            tuple(row["exit_fl"] - row["entry_fl"] for row in rows),
        )
        for rows in aircraft.values()
    ]


def read_sector(folder: Path) -> Sector:
    """Read an evaluation's sector. Raises InputError that names a missing or damaged table."""
    path = folder / "episodes.parquet"
    return sector_of(path, read_table(path, ("scenario",)))


def read_outcomes(folder: Path, first: int | None = None) -> Outcomes:
    """Read the first scenarios' results, or all. Raises InputError that names a bad table."""
    path = folder / "episodes.parquet"
    table = read_table(path, Outcomes._fields)
    outcomes = Outcomes(*(table[name].to_numpy() for name in Outcomes._fields))
    if len(np.unique(outcomes.scenario)) != len(outcomes.scenario):
        raise InputError(f"{path}: a scenario occurs twice")
    return Outcomes(*(column[:first] for column in outcomes))


def read_scenario(folder: Path, number: int) -> FlownScenario:
    """Read one scenario as flown. Raises InputError that names a missing or damaged table."""
    only = [("scenario", "=", number)]
    episode = read_table(folder / "episodes.parquet", ("clearances",), only)
    aircraft = read_table(folder / "aircraft.parquet", ("callsign", "route", "exit_fl"), only)
    flown = read_table(
        folder / "trajectories.parquet",
        ("callsign", "time_s", "lat", "lon", "fl", "cleared_fl", "status"),
        only,
    )
    issued = read_table(folder / "clearances.parquet", ("callsign", *_CLEARANCE_COLUMNS), only)
    if not episode.num_rows or not flown.num_rows:
        raise InputError(f"{folder}: has no scenario {number}")
    sector = sector_of(folder / "trajectories.parquet", flown)
    entries = aircraft.to_pylist()
    check_aircraft(folder / "aircraft.parquet", sector, entries)
    with error_context(str(folder)):
        tracks = tuple(_track(sector, row, flown, issued) for row in entries)
    return FlownScenario(sector, number, episode["clearances"][0].as_py(), tracks)


_CLEARANCE_COLUMNS = ("cycle", "kind", "value", "direction", "instructions", "text")


def _track(sector: Sector, aircraft: dict[str, Any], flown: pa.Table, issued: pa.Table) -> Track:
    callsign = aircraft["callsign"]
    rows, issued_rows = (rows_of(callsign, table).to_pylist() for table in (flown, issued))
    if not rows or any(row["cycle"] >= len(rows) for row in issued_rows):
        raise InputError(f"the rows of {callsign} are not complete")
    status = [row["status"] for row in rows]
    # The track ends where the aircraft exits.
    end = status.index("exited") + 1 if "exited" in status else len(rows)
    clearances = (
        IssuedClearance(
            time_s=rows[row["cycle"]]["time_s"], **{k: row[k] for k in _CLEARANCE_COLUMNS}
        )
        for row in issued_rows
    )
    return Track(
        callsign=callsign,
        route_nm=sector.path_nm(tuple(aircraft["route"].split())),
        position_nm=sector.plane.to_plane(
            [row["lat"] for row in rows[:end]], [row["lon"] for row in rows[:end]]
        ),
        level_fl=np.array([row["fl"] for row in rows[:end]], dtype=np.float64),
        cleared_fl=np.array([row["cleared_fl"] for row in rows[:end]], dtype=np.float64),
        exit_fl=aircraft["exit_fl"],
        excursion_cycle=status.index("excursion") if "excursion" in status[:end] else None,
        clearances=tuple(sorted(clearances, key=lambda clearance: clearance.cycle)),
    )
