"""Compare scores in another simulator with those in ours, on the same births.

    skystack flight-school sector-control --platform bluebird --seeds 20
    python -m verification.simulator.same_births runs/flight-school/sector-control-...

Flies the hours of each folder again in our simulator. Flights are born where and when they were
recorded, but the controller decides again in each cycle. Prints the scores of each hour, and the
difference of their means with its 95 % confidence interval (Student's t, of the differences by
hour). Needs no other simulator. The exit code is 1 if the means of a folder differ by more than
5 %, and 2 for invalid input.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from skystack.errors import InputError
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.flight_school import interval
from skystack.evaluation.hour_row import HourRow, read_row
from skystack.evaluation.hour_scores import Scores, score
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.stored import read_table, sector_of
from skystack.evaluation.traffic_conditions import TrafficConditions
from verification.simulator.recording import RecordedHours, read_hour

BOUND = 0.05
"""The maximum relative difference of the mean scores."""


class Pair(NamedTuple):
    """An hour's lax score where it was recorded, and in our simulator."""

    recorded_s: float
    ours_s: float


def fly_again(folder: Path, row: HourRow, seed: int) -> Scores:
    """Fly a recorded hour in our simulator, under the same controller."""
    conditions = TrafficConditions(row.traffic, cycles=row.cycles)
    found = find_controller(row.agent, conditions)
    path = folder / "episodes.parquet"
    sector = sector_of(path, read_table(path, ("scenario",)))
    hours = RecordedHours(sector, found.world.flow.slots, read_hour(folder, seed))
    hour = HourFlyer(hours.world, row.cycles, found.per_cycle, hours).fly(found.agent, 0, seed)
    return score(sector, hour)


def in_words(pairs: Sequence[Pair]) -> str:
    """The means and their difference."""
    recorded_s, ours_s = np.array(pairs).T
    mean_s, difference = recorded_s.mean(), interval(list(ours_s - recorded_s))
    between = ""
    if difference is not None:
        low, high = (100.0 * each / mean_s for each in difference)
        between = f" (95 % confidence interval: {low:+.1f} to {high:+.1f} %)"
    equal = int(np.sum(recorded_s == ours_s))
    return (
        f"{len(pairs)} hours: mean lax score {mean_s:,.0f} s as recorded and {ours_s.mean():,.0f} "
        f"s in our simulator, {100.0 * relative(pairs):+.1f} %{between}; equal in {equal} hours"
    )


def relative(pairs: Sequence[Pair]) -> float:
    """The relative difference of the means."""
    recorded_s, ours_s = np.array(pairs).mean(axis=0)
    return float(ours_s / recorded_s - 1.0)


def compare(folder: Path, console: Console) -> list[Pair]:
    """Fly all hours of a folder again, and print their scores."""
    row, pairs = read_row(folder), list[Pair]()
    console.print(f"{row.agent}, {row.traffic}, {row.platform}", highlight=False)
    for seed, recorded_s in zip(row.seeds, row.lax_s_by_hour, strict=True):
        flown = fly_again(folder, row, seed)
        pairs.append(Pair(recorded_s, flown.lax_s))
        ended = flown.lax_ended_by or "no failure"
        text = f"seed {seed}: {recorded_s:,.0f} s as recorded, {flown.lax_s:,.0f} s ({ended})"
        console.print(text, highlight=False)
    console.print(in_words(pairs), highlight=False)
    return pairs


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Compare scores on recorded births.")
    parser.add_argument("folder", type=Path, nargs="+", help="a folder of skystack flight-school")
    folders = parser.parse_args(arguments).folder
    console, apart = Console(width=150), False
    try:
        for folder in folders:
            apart |= abs(relative(compare(folder, console))) > BOUND
    except InputError as error:
        Console(stderr=True).print(str(error), markup=False)
        return 2
    return int(apart)


if __name__ == "__main__":
    sys.exit(main())
