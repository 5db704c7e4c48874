"""Compare skystack's simulator with the real BluebirdDT: random scenarios in both, row by row.

Two aircraft fly 300 cycles in every shipped sector and in four that test the geodesy: 59 to 66 N,
62 to 68 N (400 NM), 33 to 38 S, and across the antimeridian. Under both performance models there
are instructed flights (headings by direction and the shorter way, over 180 degrees, levels, both at
once, some issued before the previous one is complete), flights on own navigation with changes of
level, and flights cleared direct to fixes, with headings in between. Rows count while an aircraft
is within 400 NM of the origin. Separations measured by the simulator are compared with geodesics.
Needs the extra `[bluebird]`.

    python -m verification.simulator.bluebird_agreement [INSTRUCTED [OWN_NAVIGATION [DIRECT]]]

The defaults are 40, 10 and 10 scenarios.

Prints the largest differences in each sector as JSON; exit code 1 if one exceeds its bound.
"""

import json
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from msgspec.structs import replace

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.sector import MAX_DISTANCE_NM, Sector
from skystack.airspace.sector_file import make_sector, read_sector
from skystack.airspace.sectors import sector_named, sector_names
from skystack.platforms.bluebird import Bluebird
from skystack.platforms.flight import Flight, fly_scenario
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Platform, Report
from skystack.simulator.performance import DEFAULT_TYPE
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance

CYCLES = 300
MODELS = ("table", "constant")
DISC_NM = 4.0
"""The radius around a first fix in which aircraft start."""
MIDDLE_NM = 40.0
"""The radius around the origin in which aircraft start."""
BESIDE_NM = 15.0
"""The radius around the other aircraft: every second pair starts this close."""
SEPARATION_WITHIN_NM = 20.0
"""Separations below this are compared."""
EARTH = ("north", "arctic", "south", "dateline")
"""Files in the folder `sectors` next to this module."""
CLEARANCES = 24
"""The number of clearances for both aircraft of an instructed flight."""
INSTRUCTED, OWN_NAVIGATION, DIRECT = KINDS = ("instructed", "own navigation", "direct")
"""The kinds of flights."""
SNAP_DEG = 1.5
"""The angle that an aircraft turns in a second."""


class Worst(NamedTuple):
    """The largest differences over the rows that count, as measurements or as bounds."""

    position_nm: float
    separation_nm: float
    """The error of the plane's distance between skystack's two aircraft."""
    heading_deg: float
    level_fl: float
    """Without the rows in which only one simulator has captured a level."""
    capture_rows: float
    """The number of successive rows in which only one simulator has captured a level."""
    cleared_heading_deg: float
    cleared_fl: float


class Measured(NamedTuple):
    """The result of comparing some scenarios."""

    worst: Worst
    rows: int
    """The number of compared rows of one aircraft each."""
    snaps: int
    """The number of flights cut short because BluebirdDT snapped to a heading."""


TO_FIXES = Worst(0.02, 0.005, 0.2, 0.001, 1.0, 0.2, 0.0)
BOUNDS = {
    INSTRUCTED: Worst(0.02, 0.005, 0.001, 0.001, 1.0, 0.001, 0.0),
    OWN_NAVIGATION: TO_FIXES,
    DIRECT: TO_FIXES._replace(position_nm=0.3, heading_deg=3.0, cleared_heading_deg=3.0),
}
"""The bounds for each kind. With many clearances, the two simulators may begin a fly-by turn one
second apart; an aircraft flies 0.13 NM in a second. The bound of flights direct to fixes allows for
that; most of them satisfy `TO_FIXES`. On own navigation the cleared heading is the actual one. Half
a mile before a fix, a lateral difference of 0.001 NM changes the bearing by 0.1 degrees."""


@cache
def sector_of(name: str) -> Sector:
    """A shipped sector, or one of `EARTH`."""
    if name not in EARTH:
        return sector_named(name)
    return make_sector(read_sector(Path(__file__).parent / "sectors" / f"{name}.json"))


def random_scenario(seed: int, performance: str, kind: str, sector: Sector) -> Scenario:
    """Two aircraft near first fixes or in the middle of the sector, with random clearances."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    own_navigation = kind == OWN_NAVIGATION
    first = _random_aircraft(rng, "AC1", own_navigation, sector)
    beside = None if seed % 2 == 0 or own_navigation else (first.lat, first.lon)
    second = _random_aircraft(rng, "AC2", own_navigation, sector, beside)
    aircraft = (first, second)
    clearances: list[ScheduledClearance] = []
    for _ in range(2 if own_navigation else CLEARANCES):
        callsign = f"AC{rng.integers(1, 3)}"
        # One in three follows the previous one within two cycles, while that is still being flown.
        soon = bool(clearances) and rng.random() < 1 / 3
        last = clearances[-1] if soon else None
        cycle = last.cycle + int(rng.integers(1, 3)) if last else int(rng.integers(0, CYCLES))
        heading = None if own_navigation or rng.random() < 0.3 else int(rng.integers(0, 360))
        level = rng.random() < 0.3 or heading is None
        clearances.append(
            ScheduledClearance(
                cycle=min(cycle, CYCLES - 1),
                callsign=last.callsign if last else callsign,
                heading_deg=heading,
                turn=None if heading is None else str(rng.choice(["shortest", "left", "right"])),
                fl=int(rng.integers(20, 41)) * 10 if level else None,
            )
        )
    if kind == DIRECT:
        clearances = [_direct(rng, each, aircraft) for each in clearances]
    return Scenario(sector, performance, CYCLES, aircraft, tuple(clearances))


def _direct(
    rng: np.random.Generator, given: ScheduledClearance, aircraft: tuple[Aircraft, Aircraft]
) -> ScheduledClearance:
    """The clearance, direct to a random fix instead of to its heading in two of three cases."""
    if given.heading_deg is None or rng.random() < 1 / 3:
        return given
    route = next(each.route for each in aircraft if each.callsign == given.callsign)
    fix = str(rng.choice(route[1:]))
    return replace(given, heading_deg=None, turn=None, direct_to=fix)


def _random_aircraft(
    rng: np.random.Generator,
    callsign: str,
    own_navigation: bool,
    sector: Sector,
    beside: tuple[float, float] | None = None,
) -> Aircraft:
    route = sector.routes[rng.integers(len(sector.routes))]
    at_fix = beside is None and (own_navigation or rng.random() < 0.5)
    within_nm = DISC_NM if at_fix else MIDDLE_NM if beside is None else BESIDE_NM
    lat, lon = sector.fixes[route[0]] if at_fix else beside or sector.origin
    distance_m = rng.uniform(0.0, within_nm) * METRES_PER_NM
    lon, lat, _ = WGS84.fwd(lon, lat, rng.uniform(0.0, 360.0), distance_m)
    heading = sector.first_heading_deg(route) if at_fix else rng.uniform(0.0, 360.0)
    fl = int(rng.integers(20, 41)) * 10
    return Aircraft(callsign, DEFAULT_TYPE, route, lat, lon, float(fl), heading, fl, own_navigation)


def rows(flight: Flight) -> Report:
    """A flight as arrays `[rows, aircraft]`."""
    return Report(*(np.stack(values) for values in zip(*flight.reports, strict=True)))


def compare(scenario: Scenario, ours: Flight, theirs: Flight) -> Worst:
    """The largest differences over the rows that count."""
    us, them = rows(ours), rows(theirs)
    counts = rows_that_count(scenario, them)
    offset_nm = WGS84.inv(us.lon, us.lat, them.lon, them.lat)[2] / METRES_PER_NM
    captured = us.fl == us.cleared_fl, them.fl == them.cleared_fl
    shifted = (captured[0] != captured[1]) & counts
    level = np.where(shifted, 0.0, np.abs(us.fl - them.fl))
    return Worst(
        position_nm=_worst(offset_nm, counts),
        separation_nm=_separation_error_nm(scenario.sector, us),
        heading_deg=_worst(_angle_deg(us.heading_deg, them.heading_deg), counts),
        level_fl=_worst(level, counts),
        capture_rows=_longest_run(shifted),
        cleared_heading_deg=_worst(
            _angle_deg(us.cleared_heading_deg, them.cleared_heading_deg), counts
        ),
        cleared_fl=_worst(np.abs(us.cleared_fl - them.cleared_fl), counts),
    )


def _separation_error_nm(sector: Sector, us: Report) -> float:
    """The largest error of the plane's distance between two close aircraft."""
    plane, (lat, lon) = sector.plane, (us.lat.T, us.lon.T)
    first, second = plane.to_plane(lat, lon)
    measured = np.hypot(*(first - second).T) / plane.scale((first + second)[:, 1] / 2.0)
    geodesic = WGS84.inv(lon[0], lat[0], lon[1], lat[1])[2] / METRES_PER_NM
    return _worst(np.abs(measured - geodesic), geodesic < SEPARATION_WITHIN_NM)


def rows_that_count(scenario: Scenario, them: Report) -> Bool[np.ndarray, "rows aircraft"]:
    """The rows before an aircraft is far from the origin or BluebirdDT snaps to a heading."""
    lat, lon = scenario.sector.origin
    zero = np.zeros_like(them.lat)
    far = WGS84.inv(zero + lon, zero + lat, them.lon, them.lat)[2] > MAX_DISTANCE_NM * METRES_PER_NM
    for cycle, callsign, _ in snaps(scenario, them):
        index = [aircraft.callsign for aircraft in scenario.aircraft].index(callsign)
        far[cycle + 2 :, index] = True
    return ~np.logical_or.accumulate(far, axis=0)


def snaps(scenario: Scenario, them: Report) -> Iterator[tuple[int, str, float]]:
    """(cycle, callsign, heading) of every snap of BluebirdDT to a heading the short way.

    This is its documented bug: a turn by direction that starts within one second of turning of its
    target ends at once, whichever direction was given. Skystack obeys the direction.
    """
    index = {aircraft.callsign: number for number, aircraft in enumerate(scenario.aircraft)}
    for cycle, transmissions in scenario.transmissions().items():
        for given in transmissions:
            if given.heading_deg is None or given.turn not in {"left", "right"}:
                continue
            actual = them.heading_deg[cycle + 1, index[given.callsign]]
            turn = (given.heading_deg - actual + 180.0) % 360.0 - 180.0
            if 0.0 < (turn if given.turn == "left" else -turn) <= SNAP_DEG:
                yield cycle, given.callsign, float(given.heading_deg)


def _angle_deg(a: Float[np.ndarray, "*n"], b: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    return np.abs((a - b + 180.0) % 360.0 - 180.0)


def _worst(values: Float[np.ndarray, "*n"], counts: Bool[np.ndarray, "*n"]) -> float:
    return float(np.max(values, where=counts, initial=0.0))


def _longest_run(flags: Bool[np.ndarray, "rows aircraft"]) -> float:
    longest = run = np.zeros(flags.shape[1])
    for row in flags:
        run = np.where(row, run + 1.0, 0.0)
        longest = np.maximum(longest, run)
    return float(longest.max())


def measure(
    platforms: tuple[Platform, Platform],
    seeds: range,
    performance: str,
    kind: str,
    sector: Sector,
) -> Measured:
    """The largest differences over scenarios."""
    found, rows_compared, snapped = Worst(*[0.0] * len(Worst._fields)), 0, 0
    for seed in seeds:
        scenario = random_scenario(seed, performance, kind, sector)
        ours, theirs = (fly_scenario(platform, scenario) for platform in platforms)
        found = Worst(*np.maximum(found, compare(scenario, ours, theirs)).tolist())
        rows_compared += int(rows_that_count(scenario, rows(theirs)).sum())
        snapped += len(list(snaps(scenario, rows(theirs))))
    return Measured(found, rows_compared, snapped)


def main(arguments: list[str]) -> int:
    """Measure and print; returns the exit code."""
    counts = [int(text) for text in arguments] + [40, 10, 10][len(arguments) :]
    platforms = (Skystack(), Bluebird())
    agrees = True
    for name in (*sector_names(), *EARTH):
        for kind, count in zip(KINDS, counts, strict=True):
            for model in MODELS:
                started = time.monotonic()
                seeds = range(count)
                found = measure(platforms, seeds, model, kind, sector_of(name))
                pairs = zip(found.worst, BOUNDS[kind], strict=True)
                within = all(value <= limit for value, limit in pairs)
                agrees &= within
                line = {
                    "sector": name,
                    "flights": kind,
                    "performance": model,
                    "rollouts": len(seeds),
                    "within_bounds": within,
                    "rows": found.rows,
                    "snaps": found.snaps,
                    "wall_s": round(time.monotonic() - started, 1),
                }
                sys.stdout.write(json.dumps(line | found.worst._asdict()) + "\n")
                sys.stdout.flush()
    return 0 if agrees else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
