"""Compare scores in another simulator with those in ours, on the same births.

    skystack flight-school sector-control --platform bluebird --seeds 20
    python -m verification.simulator.same_births runs/flight-school/sector-control-...

Flies the hours of each folder again in our simulator. Flights are born where and when they were
recorded, but the controller decides again in each cycle. Prints, for each hour, both lax scores,
the number of cycles until it first decides differently, and the largest distance between flown and
recorded positions at that time; then the difference of the mean scores, with its 95 % confidence
interval (Student's t, of the differences by hour). Needs no other simulator. The exit code is 1 if
the means of a folder differ by more than 5 %, and 2 for invalid input.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skystack.agents.transmission import Transmission
from skystack.airspace.sector import Sector
from skystack.errors import InputError, error_context
from skystack.evaluation.controllers import PERFORMANCE, ControlledWorld, find_controller
from skystack.evaluation.fixed_traffic import is_fixed
from skystack.evaluation.flight_school import interval
from skystack.evaluation.hour_row import ROW_FILE, HourRow, read_row
from skystack.evaluation.hour_scores import score
from skystack.evaluation.hours import Hour, HourFlyer
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.simulator.arrivals import FREE
from verification.simulator.recording import (
    Recorded,
    RecordedHours,
    distance_nm,
    read_hour,
    row_of,
)

BOUND = 0.05
"""The maximum relative difference of the mean scores."""


class Pair(NamedTuple):
    """An hour where it was recorded, and in our simulator."""

    recorded_s: float
    """The lax score."""
    ours_s: float
    same_cycles: int
    """The number of cycles before the first in which the transmissions differ."""
    apart_nm: float
    """The largest distance between flown and recorded positions after these cycles."""


def controller_of(folder: Path, row: HourRow) -> ControlledWorld:
    """The controller that flew the hours of a folder.

    Raises InputError if they cannot be flown again with recorded births.
    """
    path = folder / ROW_FILE
    if row.seed_numbers is None or len(row.seeds) != len(row.lax_s_by_hour):
        raise InputError(f"{path}: not the row of skystack flight-school")
    if row.uncertainty or is_fixed(row.traffic) or is_scenario(row.traffic):
        raise InputError(f"{path}: only random traffic without uncertainty can be flown again")
    if not any(row.lax_s_by_hour):
        raise InputError(f"{path}: all lax scores are 0")
    conditions = TrafficConditions(
        row.traffic,
        per_cycle=row.per_cycle,
        cycles=row.cycles,
        sector=row.sector,
        safety_net=row.safety_net is not False,
    )
    found = find_controller(row.agent, conditions)
    if found.performance != PERFORMANCE:
        raise InputError(f"{path}: performance is {found.performance} (allowed: {PERFORMANCE})")
    return found


def fly_again(folder: Path, found: ControlledWorld, seed: int, recorded_s: float) -> Pair:
    """Fly a recorded hour in our simulator, under the same controller."""
    sector, recorded = found.world.sector, read_hour(folder, seed)
    with error_context(f"{folder}: hour {seed}"):
        hours = RecordedHours(sector, found.world.flow.slots, recorded)
    flyer = HourFlyer(hours.world, recorded.cycles, found.per_cycle, hours)
    hour = flyer.fly(found.agent, 0, seed)
    same = same_cycles(recorded, hour, hours.order)
    apart_nm = apart_after(same, sector, recorded, hour, hours.order)
    return Pair(recorded_s, score(sector, hour).lax_s, same, apart_nm)


def same_cycles(recorded: Recorded, hour: Hour, order: Sequence[int]) -> int:
    """The number of cycles before the first in which the transmissions differ.

    Flight k of the hour is track `order[k]` of the recorded one.
    """
    ours: dict[int, list[tuple[int, Transmission]]] = {}
    for each in hour.sent:
        ours.setdefault(each.cycle, []).append((order[each.flight], each.transmission))
    for cycle in range(recorded.cycles):
        if _contents(ours.get(cycle, ())) != _contents(recorded.sent.get(cycle, ())):
            return cycle
    return recorded.cycles


def apart_after(
    cycles: int, sector: Sector, recorded: Recorded, hour: Hour, order: Sequence[int]
) -> float:
    """The largest distance in NM between flown and recorded positions after some cycles."""
    apart_nm = [0.0]
    if cycles:
        for slot in np.flatnonzero(hour.flight[cycles - 1] != FREE).tolist():
            track = recorded.tracks[order[hour.flight[cycles - 1, slot]]]
            row = row_of(track, cycles)
            if row is not None:
                position_nm = np.array(hour.traffic.position_nm[cycles - 1, slot])
                apart_nm.append(distance_nm(sector, track, row, position_nm))
    return max(apart_nm)


def _contents(sent: Sequence[tuple[int, Transmission]]) -> set[tuple[object, ...]]:
    """The track, and what was transmitted, of each transmission."""
    return {(track, each.heading_deg, each.fix, each.level_ticks) for track, each in sent}


def in_words(pairs: Sequence[Pair]) -> str:
    """The means and their difference."""
    recorded_s, ours_s, same, apart_nm = np.array(pairs).T
    mean_s, difference = recorded_s.mean(), interval(list(ours_s - recorded_s))
    between = ""
    if difference is not None:
        low, high = (100.0 * each / mean_s for each in difference)
        between = f" (95 % confidence interval: {low:+.1f} to {high:+.1f} %)"
    return (
        f"hours: {len(pairs)}; mean lax score: {mean_s:,.0f} s as recorded, {ours_s.mean():,.0f} s "
        f"in skystack, {100.0 * relative(pairs):+.1f} %{between}; equal scores: "
        f"{np.sum(recorded_s == ours_s)}; medians: the same decisions for {np.median(same):.0f} "
        f"cycles, positions then at most {np.median(apart_nm):.4f} NM apart"
    )


def relative(pairs: Sequence[Pair]) -> float:
    """The relative difference of the means."""
    recorded_s, ours_s, *_ = np.array(pairs).mean(axis=0)
    return float(ours_s / recorded_s - 1.0)


def compare(folder: Path) -> list[Pair]:
    """Fly all hours of a folder again, and print their scores."""
    row, pairs = read_row(folder), list[Pair]()
    found = controller_of(folder, row)
    sys.stdout.write(f"{row.agent}, {row.traffic}, {row.platform}\n")
    for seed, recorded_s in zip(row.seeds, row.lax_s_by_hour, strict=True):
        pairs.append(pair := fly_again(folder, found, seed, recorded_s))
        sys.stdout.write(
            f"seed {seed}: {recorded_s:,.0f} s as recorded, {pair.ours_s:,.0f} s in skystack; the "
            f"same decisions for {pair.same_cycles} cycles, positions then at most "
            f"{pair.apart_nm:.4f} NM apart\n"
        )
        sys.stdout.flush()
    sys.stdout.write(f"{in_words(pairs)}\n")
    return pairs


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Compare scores on recorded births.")
    parser.add_argument("folder", type=Path, nargs="+", help="a folder of skystack flight-school")
    folders, apart = parser.parse_args(arguments).folder, False
    try:
        for folder in folders:
            apart |= abs(relative(compare(folder))) > BOUND
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return int(apart)


if __name__ == "__main__":
    sys.exit(main())
