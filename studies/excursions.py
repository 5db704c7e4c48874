"""Where flights make excursions: how many are near an inner corner of the sector.

    skystack flight-school search --platform bluesky --seeds 20 --first-seed 1
    python -m studies.excursions runs/flight-school/search-...

An inner corner is one that points into the area, which is not convex there. Reads the tables of a
folder. Of the flights that entered the area and left it elsewhere than through their exits, prints
the number, the share within 1 NM of an inner corner, and the distance outside the area. Positions
are those at the end of the cycle in which a flight left, so none is far outside: at 450 kt, a
flight covers 0.75 NM in a cycle.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from skystack.airspace.sector import Sector, distance_to_line
from skystack.errors import InputError
from skystack.evaluation.stored import read_table, sector_of

NEAR_NM = 1.0
STRAIGHT_DEG = 1.0
"""Edges that meet at a smaller angle make no corner."""


class Excursion(NamedTuple):
    """Where a flight was at the end of the cycle in which it left."""

    corner_nm: float
    """The distance to the nearest inner corner; infinite if there is none."""
    outside_nm: float
    """The distance to the boundary."""


class Boundary:
    """The boundary of a sector, and its inner corners."""

    def __init__(self, sector: Sector) -> None:
        self._plane = sector.plane
        self._line_nm = np.concatenate([sector.area_nm, sector.area_nm[:1]])
        self.inner_corners_nm = _inner_corners(sector)
        """In the plane, `[corners, 2]`."""

    def excursion(self, lat: float, lon: float) -> Excursion:
        """The distances of a point, given in degrees."""
        point = self._plane.to_plane(lat, lon)
        scale = float(self._plane.scale(point[1:])[0])
        corners_nm = np.hypot(*(self.inner_corners_nm - point).T)
        corner_nm = float(np.min(corners_nm, initial=np.inf))
        return Excursion(corner_nm / scale, distance_to_line(point, self._line_nm) / scale)


def _inner_corners(sector: Sector) -> Float[np.ndarray, "corners 2"]:
    corners = np.array([sector.plane.to_plane(*point) for point in sector.area])
    into, out = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    cross = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    turn_deg = np.degrees(np.arctan2(cross, np.sum(into * out, axis=1)))
    # The turns of a polygon add up to 360 degrees, with the sign of its direction.
    return corners[turn_deg * np.sign(turn_deg.sum()) < -STRAIGHT_DEG]


def excursions(folder: Path) -> list[Excursion]:
    """The excursions of flights that had entered the area. Raises InputError for damaged tables."""
    path = folder / "episodes.parquet"
    boundary = Boundary(sector_of(path, read_table(path, ("scenario",))))
    names = ("scenario", "callsign", "gone_cycle")
    has_left = [("excursion", "=", True), ("entry_cycle", ">=", 0)]
    left = read_table(folder / "aircraft.parquet", names, has_left)
    gone = {tuple(row.values()) for row in left.to_pylist()}
    found = []
    for number in sorted({number for number, *_ in gone}):
        cycles = [cycle for each, _, cycle in gone if each == number]
        of_hour = [("scenario", "=", number), ("cycle", "in", cycles)]
        columns = ("scenario", "callsign", "cycle", "lat", "lon")
        for row in read_table(folder / "trajectories.parquet", columns, of_hour).to_pylist():
            *flight, lat, lon = row.values()
            if tuple(flight) in gone:
                found.append(boundary.excursion(lat, lon))
    return found


def in_words(found: Sequence[Excursion]) -> str:
    """The number of excursions, and where they were."""
    if not found:
        return "no flight that had entered the area made an excursion"
    corner_nm, outside_nm = np.array(found).T
    return (
        f"excursions: {len(found)}; within {NEAR_NM:g} NM of an inner corner: "
        f"{100.0 * np.mean(corner_nm <= NEAR_NM):.0f} %; distance outside the area: median "
        f"{np.median(outside_nm):.2f} NM, 90th percentile {np.quantile(outside_nm, 0.9):.2f} NM"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Where flights make excursions.")
    parser.add_argument("folder", type=Path, nargs="+", help="a folder of skystack flight-school")
    try:
        for folder in parser.parse_args(arguments).folder:
            sys.stdout.write(f"{folder.name}: {in_words(excursions(folder))}\n")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
