"""Where flights make excursions: how many cut an inner corner of the sector, and by how much.

    skystack flight-school search --platform bluesky --seeds 20 --first-seed 1
    python -m studies.excursions runs/flight-school/search-...

An inner corner is one at which the area is not convex. Reads the tables of a folder, and prints the
number of flights that left the area elsewhere than through their exits, the share of those that
were then within 1 NM of an inner corner, and how far outside the area they were.
"""

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from rich.console import Console

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.evaluation.stored import read_table, sector_of

NEAR_NM = 1.0
STRAIGHT_DEG = 1.0
"""Edges that meet at a smaller angle make no corner."""


class Excursion(NamedTuple):
    """Where a flight was at the end of the cycle in which it left."""

    corner_nm: float
    """The distance to the nearest inner corner."""
    outside_nm: float
    """The distance to the nearest edge of the area."""


def inner_corners(sector: Sector) -> Float[np.ndarray, "corners 2"]:
    """The corners at which the area is not convex, in the plane."""
    corners = np.array([sector.plane.to_plane(*point) for point in sector.area])
    into, out = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    cross = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    turn_deg = np.degrees(np.arctan2(cross, np.sum(into * out, axis=1)))
    # The turns of a polygon add up to 360 degrees, with the sign of its direction.
    return corners[turn_deg * np.sign(turn_deg.sum()) < -STRAIGHT_DEG]


def excursions(folder: Path) -> list[Excursion]:
    """The excursions of flights that had entered the area. Raises InputError for damaged tables."""
    path = folder / "episodes.parquet"
    sector = sector_of(path, read_table(path, ("scenario",)))
    names = ("scenario", "callsign", "gone_cycle")
    has_left = [("excursion", "=", True), ("entry_cycle", ">=", 0)]
    left = read_table(folder / "aircraft.parquet", names, has_left)
    gone = {tuple(row.values()) for row in left.to_pylist()}
    found = []
    for number in sorted({number for number, *_ in gone}):
        cycles = [cycle for each, _, cycle in gone if each == number]
        of_hour = [("scenario", "=", number), ("cycle", "in", cycles)]
        columns = ("scenario", "callsign", "cycle", "lat", "lon")
        for *flight, lat, lon in _rows(folder / "trajectories.parquet", columns, of_hour):
            if tuple(flight) in gone:
                found.append(_excursion(sector, lat, lon))
    return found


def _rows(path: Path, columns: Sequence[str], filters: Any) -> Iterator[Iterable[Any]]:
    return (row.values() for row in read_table(path, columns, filters).to_pylist())


def _excursion(sector: Sector, lat: float, lon: float) -> Excursion:
    point, area = sector.plane.to_plane(lat, lon), sector.area_nm
    along = np.roll(area, -1, axis=0) - area
    share = np.sum((point - area) * along, axis=1) / np.sum(along**2, axis=1)
    nearest = area + np.clip(share, 0.0, 1.0)[:, None] * along
    scale = float(sector.plane.scale(point[1:])[0])
    corner = min(np.hypot(*(inner_corners(sector) - point).T), default=np.inf)
    return Excursion(float(corner) / scale, float(np.min(np.hypot(*(nearest - point).T))) / scale)


def in_words(found: Sequence[Excursion]) -> str:
    """The number of excursions, and where they were."""
    if not found:
        return "no flight that had entered the area made an excursion"
    corner_nm, outside_nm = np.array(found).T
    return (
        f"{len(found)} excursions, {100.0 * np.mean(corner_nm <= NEAR_NM):.0f} % of them within "
        f"{NEAR_NM:g} NM of an inner corner; distance outside the area: median "
        f"{np.median(outside_nm):.2f} NM, 90th percentile {np.quantile(outside_nm, 0.9):.2f} NM"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Where flights make excursions.")
    parser.add_argument("folder", type=Path, nargs="+", help="a folder of skystack flight-school")
    console = Console(width=200)
    try:
        for folder in parser.parse_args(arguments).folder:
            console.print(f"{folder.name}: {in_words(excursions(folder))}", highlight=False)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
