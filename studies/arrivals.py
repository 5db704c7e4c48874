"""Flight School traffic in skystack and in BluebirdDT, compared by distribution.

    python -m studies.arrivals [category|notebook|environment ...] [--hours 200] [--out DIR]

Flies hours without instructions in both simulators and prints a Markdown table with the two-sample
tests of what arrives: the numbers of births and of flights present, times of birth, gaps, twins,
routes, levels, speeds and positions. A small p-value suggests a difference. There are 16 tests per
kind of traffic, so about one p-value below 0.05 is expected by chance. After every five hours, the
births are stored in DIR, from which they are reused: the command can be interrupted and repeated.
Needs the extra `[bluebird]`.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import msgspec
import numpy as np
from scipy.stats import chi2_contingency, ks_2samp, mannwhitneyu

from skystack.airspace.sector import Sector
from skystack.errors import InputError, checked_integer
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.io.files import atomic_write, make_folder
from skystack.learning.seeds import scenario_key
from skystack.platforms.bluebird_traffic import FlightSchoolTraffic
from skystack.platforms.registry import check_platform
from skystack.reporting.table import Table
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL, HOUR_CYCLES
from skystack.simulator.arrivals import Arrivals, release
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import Traffic
from skystack.tasks.sector_world import World, is_far
from studies.parallel import run_pieces

HOURS_A_PIECE = 5


class Birth(NamedTuple):
    """A flight that was born after the start."""

    hour: int
    cycle: int
    route: str
    entry_fl: float
    exit_fl: float
    speed_kt: float
    lat: float
    lon: float


class Arrived(NamedTuple):
    """What arrived in some hours."""

    births: list[Birth]
    present: list[tuple[int, ...]]
    """For each hour, the number of flights after each sixth of it."""


class Comparison(NamedTuple):
    """A two-sample test."""

    what: str
    test: str
    ours: str
    bluebird: str
    p: float


def in_skystack(traffic: str, first: int, hours: int) -> Arrived:
    """Hours in skystack.

    Flights are removed only when they are far outside the sector. Unlike in BluebirdDT, this
    includes the few that happen to leave through their exit at their exit level.
    """
    world = find_controller("no-op", TrafficConditions(traffic)).world
    draw, advance = jax.jit(world.flow.draw), jax.jit(partial(_cycle, world))
    births, present = list[Birth](), list[tuple[int, ...]]()
    for hour in range(first, first + hours):
        (arrivals, flying), counts = draw(scenario_key(0, hour)), []
        for cycle in range(1, HOUR_CYCLES + 1):
            arrivals, flying, born = advance(arrivals, flying)
            births += _born(world.sector, arrivals, flying, np.asarray(born), hour, cycle)
            counts.append(int(flying.active.sum()))
        present.append(_sixths(counts))
    return Arrived(births, present)


def _cycle(world: World, arrivals: Arrivals, traffic: Traffic) -> tuple[Arrivals, Traffic, Any]:
    """A cycle, and which flights were born in it."""
    _, born, arrivals, flown = world.fly(arrivals, traffic)
    return *release(arrivals, flown, flown.active & is_far(world.sector, flown)), born


def _born(
    sector: Sector, arrivals: Arrivals, traffic: Traffic, born: Any, hour: int, cycle: int
) -> Iterator[Birth]:
    slots = np.flatnonzero(born)
    degrees = sector.plane.to_degrees(np.asarray(traffic.position_nm)[slots])
    for slot, (lat, lon) in zip(slots.tolist(), degrees.tolist(), strict=True):
        yield Birth(
            hour,
            cycle,
            " ".join(sector.routes[int(traffic.route[slot])]),
            float(arrivals.entry_level_ticks[slot]) / TICKS_PER_FL,
            float(arrivals.exit_level_ticks[slot]) / TICKS_PER_FL,
            float(traffic.ground_speed_kt[slot]),
            lat,
            lon,
        )


def in_bluebird(traffic: str, first: int, hours: int) -> Arrived:
    """Hours in BluebirdDT."""
    births, present = list[Birth](), list[tuple[int, ...]]()
    with closing(FlightSchoolTraffic(FLIGHT_SCHOOL[traffic])) as bluebird:
        for hour in range(first, first + hours):
            seen, counts = set(bluebird.reset(hour)), []
            for cycle in range(1, HOUR_CYCLES + 1):
                reports = bluebird.advance()
                births += [
                    Birth(
                        hour,
                        cycle,
                        " ".join(report.route),
                        report.entry_fl,
                        report.exit_fl,
                        report.airspeed_kt,
                        report.lat,
                        report.lon,
                    )
                    for callsign, report in reports.items()
                    if callsign not in seen
                ]
                seen |= set(reports)
                counts.append(len(reports))
            present.append(_sixths(counts))
    return Arrived(births, present)


def _sixths(counts: list[int]) -> tuple[int, ...]:
    step = HOUR_CYCLES // 6
    return tuple(counts[step - 1 :: step])


def compare(ours: Arrived, theirs: Arrived) -> list[Comparison]:
    """All tests of what arrived in skystack and in BluebirdDT."""
    both = (ours, theirs)
    hours = [np.bincount([each.hour for each in of.births]) for of in both]
    tests = [_ranks("births in an hour", *(counts[counts > 0] for counts in hours))]
    for number in range(6):
        at = [np.array([each[number] for each in of.present]) for of in both]
        tests.append(_ranks(f"flights after {600 * (number + 1):,} s", *at))
    for what, values in (
        ("time of birth", [[6.0 * each.cycle for each in of.births] for of in both]),
        ("gap between births", [_gaps(of.births) for of in both]),
        ("speed", [[each.speed_kt for each in of.births] for of in both]),
        ("latitude of birth", [[each.lat for each in of.births] for of in both]),
        ("longitude of birth", [[each.lon for each in of.births] for of in both]),
    ):
        one, two = values
        p = float(ks_2samp(one, two).pvalue)
        tests.append(Comparison(what, "Kolmogorov-Smirnov", _mean(one), _mean(two), p))
    for what, names in (
        ("births in a cycle with births", [_twins(of.births) for of in both]),
        ("route", [[each.route for each in of.births] for of in both]),
        ("entry level", [[f"{each.entry_fl:.0f}" for each in of.births] for of in both]),
        ("exit level", [[f"{each.exit_fl:.0f}" for each in of.births] for of in both]),
    ):
        tests.append(_counts(what, *names))
    return tests


def _ranks(what: str, ours: np.ndarray, theirs: np.ndarray) -> Comparison:
    p = float(mannwhitneyu(ours, theirs).pvalue)
    return Comparison(what, "Mann-Whitney", _mean(ours), _mean(theirs), p)


def _mean(values: Any) -> str:
    return f"{np.mean(values):,.2f}"


def _gaps(births: Sequence[Birth]) -> list[float]:
    """The seconds between cycles with births."""
    cycles = sorted({(each.hour, each.cycle) for each in births})
    return [6.0 * (two[1] - one[1]) for one, two in pairwise(cycles) if one[0] == two[0]]


def _twins(births: Sequence[Birth]) -> list[str]:
    """The number of births in each cycle with births, three or more as one class."""
    counts = Counter((each.hour, each.cycle) for each in births)
    return [f"{min(count, 3)}" for count in counts.values()]


def _counts(what: str, ours: Sequence[str], theirs: Sequence[str]) -> Comparison:
    kinds = sorted({*ours, *theirs})
    table = [[names.count(kind) for kind in kinds] for names in map(list, (ours, theirs))]
    one, two = (f"{100.0 * row[0] / sum(row):.1f} % {kinds[0]}" for row in table)
    return Comparison(what, "chi-squared", one, two, float(chi2_contingency(table).pvalue))


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.arrivals", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("traffic", nargs="*", metavar="TRAFFIC", default=list(FLIGHT_SCHOOL))
    parser.add_argument("--hours", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("runs/arrivals"))
    options = parser.parse_args(arguments)
    try:
        checked_integer("--hours", options.hours, 2)
        check_platform("bluebird")
        for traffic in options.traffic:
            if traffic not in FLIGHT_SCHOOL:
                raise InputError(f"traffic {traffic!r} (allowed: {', '.join(FLIGHT_SCHOOL)})")
        make_folder(options.out)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    for traffic in options.traffic:
        pieces = [
            (simulator, traffic, first, min(HOURS_A_PIECE, options.hours - first), options.out)
            for simulator in (in_bluebird, in_skystack)
            for first in range(0, options.hours, HOURS_A_PIECE)
        ]
        found = run_pieces(_arrived, pieces, "pieces")
        half = len(found) // 2
        tests = compare(_together(found[half:]), _together(found[:half]))
        rows = [(each.what, each.test, each.ours, each.bluebird, f"{each.p:.3f}") for each in tests]
        header = (f"{traffic}, {options.hours} hours", "test", "skystack", "BluebirdDT", "p")
        sys.stdout.write(Table(header, tuple(rows)).as_markdown() + "\n")
    return 0


def _arrived(
    simulator: Callable[[str, int, int], Arrived], traffic: str, first: int, hours: int, out: Path
) -> Arrived:
    """What arrived in some hours, from its file if they have been flown before."""
    path = out / f"{simulator.__name__}-{traffic}-{first}-{hours}.json"
    if path.exists():
        return msgspec.json.decode(path.read_bytes(), type=Arrived)
    arrived = simulator(traffic, first, hours)
    atomic_write(path, msgspec.json.encode(arrived))
    return arrived


def _together(parts: Sequence[Arrived]) -> Arrived:
    return Arrived(
        [birth for part in parts for birth in part.births],
        [counts for part in parts for counts in part.present],
    )


if __name__ == "__main__":
    raise SystemExit(main())
