"""Fly hours recorded in another simulator again in ours, with the same births and clearances.

    skystack flight-school search --platform bluebird --seeds 20
    python -m verification.simulator.recorded_hours runs/flight-school/search-...

Reads the tables of the hours. Prints, for each hour, the largest distance between flown and
recorded positions, the number of positions at a different level, and the number of flights that
leave in a different cycle. Needs no other simulator. The exit code is 1 if positions differ by more
than 0.02 NM, or any level or exit differs, and 2 for invalid input.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.evaluation.stored import read_table, sector_of
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import TICKS_PER_FL
from verification.simulator.recording import (
    Recorded,
    RecordedHours,
    distance_nm,
    read_hour,
    row_of,
)

BOUND_NM, LEVEL_FL = 0.02, 1e-3
SLOTS = 192


class Agreement(NamedTuple):
    """How far the flights of an hour are from where they were recorded."""

    flights: int
    rows: int
    worst_nm: float
    far_rows: int
    """Rows more than `BOUND_NM` away."""
    far_flights: int
    """The flights of these rows."""
    wrong_levels: int
    """Rows at a different level."""
    wrong_exits: int
    """Flights that leave in a different cycle."""


def agreement(sector: Sector, hour: Recorded) -> Agreement:
    """Fly a recorded hour in our simulator."""
    hours = RecordedHours(sector, SLOTS, hour)
    state, order = hours.reset(0, 0), hours.order
    number = {index: flight for flight, index in enumerate(order)}
    apart_nm, levels = dict[int, list[float]](), list[bool]()
    left: dict[int, int] = {}
    for cycle in range(hour.cycles):
        slots = {int(each): slot for slot, each in enumerate(state.arrivals.flight)}
        told = [
            each._replace(slot=slots[number[index]])
            for index, each in hour.sent.get(cycle, ())
            if number[index] in slots
        ]
        state, flown = hours.advance(state, told)
        for slot in np.flatnonzero(flown.flight != FREE).tolist():
            index = order[int(flown.flight[slot])]
            if flown.exited[slot] or flown.excursion[slot]:
                left[index] = cycle + 1
            track = hour.tracks[index]
            row = row_of(track, cycle + 1)
            if row is not None:
                offset_nm = distance_nm(
                    sector, track, row, np.array(flown.traffic.position_nm[slot])
                )
                apart_nm.setdefault(index, []).append(offset_nm)
                level_fl = float(flown.traffic.level_ticks[slot]) / TICKS_PER_FL
                levels.append(abs(level_fl - track.fl[row]) > LEVEL_FL)
    wrong = sum(left.get(index) != each.gone_cycle for index, each in enumerate(hour.tracks))
    far = [sum(each > BOUND_NM for each in offsets) for offsets in apart_nm.values()]
    return Agreement(
        flights=len(hour.tracks),
        rows=len(levels),
        worst_nm=max(max(offsets) for offsets in apart_nm.values()),
        far_rows=sum(far),
        far_flights=sum(count > 0 for count in far),
        wrong_levels=sum(levels),
        wrong_exits=wrong,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Fly recorded hours again, and compare.")
    parser.add_argument("folder", type=Path, help="a folder with the tables of hours")
    folder = parser.parse_args(arguments).folder
    path, found = folder / "episodes.parquet", []
    try:
        episodes = read_table(path, ("scenario",))
        sector = sector_of(path, episodes)
        for number in episodes["scenario"].to_pylist():
            found.append(agreement(sector, read_hour(folder, number)))
            sys.stdout.write(f"hour {number}: {in_words(found[-1])}\n")
            sys.stdout.flush()
        if not found:
            raise InputError(f"{path}: has no hours")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    total = Agreement(*map(sum, zip(*found, strict=True)))
    worst_nm = max(each.worst_nm for each in found)
    sys.stdout.write(f"{len(found)} hours: {in_words(total._replace(worst_nm=worst_nm))}\n")
    return int(worst_nm > BOUND_NM or total.wrong_levels + total.wrong_exits > 0)


def in_words(found: Agreement) -> str:
    return (
        f"{found.flights:,} flights, {found.rows:,} positions, at most {found.worst_nm:.4f} NM "
        f"apart; more than {BOUND_NM} NM apart: {found.far_rows} positions of "
        f"{found.far_flights} flights; at a different level: {found.wrong_levels} positions; "
        f"leaving in a different cycle: {found.wrong_exits} flights"
    )


if __name__ == "__main__":
    sys.exit(main())
