"""One evaluation's Parquet tables: outcomes of all scenarios, and one scenario to draw."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.evaluation.stored import read_table, sector_of

BURST_GAP_CYCLES = 2
"""Two aircraft under one policy take turns: a burst for either may skip every other cycle."""


class Clearance(NamedTuple):
    """What was issued to a pilot, and when."""

    cycle: int
    time_s: int
    kind: str
    value: int
    direction: str | None
    """None where the aircraft already flies the value."""
    instructions: int
    text: str

    @property
    def short(self) -> str:
        """`right 215`, `climb FL340`, or `fly 215` where nothing is to be turned."""
        return f"{self.direction or 'fly'} {self.target}"

    def carries_on(self, before: "Clearance") -> bool:
        """Whether a controller could have said both at once: farther the same way, and soon."""
        change = self.value - before.value
        forward = change % 360 < 180 if self.kind == "heading" else change > 0
        return (
            (self.kind, self.direction) == (before.kind, before.direction)
            and forward == (self.direction in {"right", "climb"})
            and self.cycle - before.cycle <= BURST_GAP_CYCLES
        )

    @property
    def target(self) -> str:
        """The cleared heading in three figures or the cleared level."""
        return f"FL{self.value}" if self.kind == "level" else f"{self.value:03d}"


@dataclass(frozen=True)
class Track:
    """One aircraft in one scenario, from the start to its exit or the scenario's end."""

    callsign: str
    route_nm: Float[np.ndarray, "fixes 2"]
    position_nm: Float[np.ndarray, "rows 2"]
    """Row k is cycle k; in the sector's plane."""
    level_fl: Float[np.ndarray, " rows"]
    cleared_fl: Float[np.ndarray, " rows"]
    exit_fl: int
    strayed_cycle: int | None
    clearances: tuple[Clearance, ...]

    @property
    def bursts(self) -> list[list[Clearance]]:
        """Clearances in runs that follow each other at once and go the same way."""
        runs: list[list[Clearance]] = [[first] for first in self.clearances[:1]]
        for before, after in pairwise(self.clearances):
            if after.carries_on(before):
                runs[-1].append(after)
            else:
                runs.append([after])
        return runs


@dataclass(frozen=True)
class Scenario:
    """One scenario as it was flown."""

    sector: Sector
    number: int
    clearances: int
    tracks: tuple[Track, ...]


class Outcomes(NamedTuple):
    """Results of the first scenarios of an evaluation."""

    scenario: Int[np.ndarray, " scenarios"]
    clearances: Int[np.ndarray, " scenarios"]
    success: np.ndarray
    min_separation_nm: np.ndarray
    """Infinite where no two aircraft were less than 1,000 ft apart."""


def read_outcomes(folder: Path, first: int) -> Outcomes:
    """The first scenarios' results. Raises InputError that names a missing or damaged table."""
    table = read_table(folder / "episodes.parquet", Outcomes._fields)
    return Outcomes(*(table[name].to_numpy()[:first] for name in Outcomes._fields))


def read_scenario(folder: Path, number: int) -> Scenario:
    """Everything about one scenario. Raises InputError that names a missing or damaged table."""
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
    tracks = tuple(_track(sector, row, flown, issued) for row in aircraft.to_pylist())
    return Scenario(sector, number, episode["clearances"][0].as_py(), tracks)


_CLEARANCE_COLUMNS = ("cycle", "kind", "value", "direction", "instructions", "text")


def _track(sector: Sector, aircraft: dict[str, Any], flown: pa.Table, issued: pa.Table) -> Track:
    callsign = aircraft["callsign"]
    rows = [row for row in flown.to_pylist() if row["callsign"] == callsign]
    status = [row["status"] for row in rows]
    # What exited aircraft do afterwards is nobody's business any more.
    end = status.index("exited") + 1 if "exited" in status else len(rows)
    clearances = (
        Clearance(time_s=rows[row["cycle"]]["time_s"], **{k: row[k] for k in _CLEARANCE_COLUMNS})
        for row in issued.to_pylist()
        if row["callsign"] == callsign
    )
    return Track(
        callsign=callsign,
        route_nm=np.array([sector.fixes_nm[fix] for fix in aircraft["route"].split()]).reshape(
            -1, 2
        ),
        position_nm=sector.plane.to_plane(
            [row["lat"] for row in rows[:end]], [row["lon"] for row in rows[:end]]
        ),
        level_fl=np.array([row["fl"] for row in rows[:end]], dtype=np.float64),
        cleared_fl=np.array([row["cleared_fl"] for row in rows[:end]], dtype=np.float64),
        exit_fl=aircraft["exit_fl"],
        strayed_cycle=status.index("strayed") if "strayed" in status[:end] else None,
        clearances=tuple(sorted(clearances, key=lambda clearance: clearance.cycle)),
    )
