"""Fly for thirty days (432,000 cycles) without a pause and check that nothing drifts.

    python -m verification.simulator.thirty_days [--cycles N]

Aircraft circle and fly holding patterns, in both directions, near the origin and 200 NM from it;
half of them climb and descend by 20 levels all the time. Their laps are centred on the equator:
elsewhere converging meridians move a lap that is flown by headings. The simulator keeps no clock,
so only the state of an aircraft could drift. Heading and level must equal the closed form in every
cycle, to the last bit; the position must return after every lap, except for rounding. Prints the
worst values; exit code 1 if one is beyond its bound.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from rich.console import Console
from rich.progress import track
from rich.table import Table

from skystack.airspace.sectors import sector_named
from skystack.simulator.performance import PERFORMANCE, TICKS_PER_FL
from skystack.simulator.simulator import Simulator, instruct
from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, Clearance, Traffic, start

DAYS, DAY = 30, 24 * 3600 // 6
AT_ONCE = 7200
"""The number of cycles per call: half a day, a whole number of laps."""
LAP, LEG, CHANGE = 80, 40, 10
"""Numbers of cycles: of two circles or one holding pattern, of half of that, and between two
changes of level."""
LOW_FL, CLIMB_FL = 300.0, 20.0
PATTERNS = np.array(list(product((False, True), (LEFT, RIGHT), (False, True), (0.0, 200.0))))
"""For each aircraft: holding or not, side, climbing or not, distance from the origin [NM]."""
HOLDS, SIDE, CLIMBS, FAR_NM = PATTERNS[:, 0] > 0, PATTERNS[:, 1], PATTERNS[:, 2] > 0, PATTERNS[:, 3]
BOUNDS = {"heading": (0.0, "deg"), "level": (0.0, "ticks"), "back after a lap": (0.1, "NM")}


class Rows(NamedTuple):
    """The values that are checked after every cycle."""

    heading_deg: Float[Array, "cycles aircraft"]
    level: Float[Array, "cycles aircraft"]
    position_nm: Float[Array, "cycles aircraft 2"]


def begin(simulator: Simulator, north_nm: Float[np.ndarray, " aircraft"]) -> Traffic:
    """The start of all patterns: heading north, `north_nm` north of the equator."""
    count = len(PATTERNS)
    level = jnp.full(count, LOW_FL * TICKS_PER_FL, dtype=jnp.float32)
    return start(
        position_nm=jnp.asarray(np.stack([FAR_NM, north_nm], axis=1), dtype=jnp.float32),
        heading_deg=jnp.zeros_like(level),
        level_ticks=level,
        route=jnp.zeros(count, dtype=jnp.int32),
        ground_speed_kt=simulator.level_ground_speed_kt(level),
        own_navigation=jnp.zeros(count, dtype=bool),
    )


def clearances(cycle: Int[Array, ""]) -> Clearance:
    """The clearances before a cycle: a turn by 90 degrees every 10 cycles, or by 180 every 40."""
    every, by = jnp.where(HOLDS, LEG, 10), jnp.where(HOLDS, 180, 90)
    to_the_right = (cycle // every + 1) * by % 360
    heading = jnp.where(SIDE == RIGHT, to_the_right, -to_the_right % 360)
    high = cycle // CHANGE % 2 == 0
    level = jnp.where(high, LOW_FL + CLIMB_FL, LOW_FL) * TICKS_PER_FL
    side = jnp.asarray(SIDE, dtype=jnp.int32)
    return Clearance(
        turn=jnp.where(cycle % every == 0, side, NO_TURN),
        heading_deg=heading.astype(jnp.float32),
        changes_level=jnp.asarray(CLIMBS) & (cycle % CHANGE == 0),
        level_ticks=jnp.full(len(PATTERNS), level),
    )


def fly(simulator: Simulator, traffic: Traffic, first: Int[Array, ""]) -> tuple[Traffic, Rows]:
    """Fly `AT_ONCE` cycles, starting with number `first`."""

    def cycle(now: Traffic, number: Int[Array, ""]) -> tuple[Traffic, Rows]:
        after = simulator.advance(instruct(now, clearances(number)))
        return after, Rows(after.heading_deg, after.level_ticks, after.position_nm)

    numbers = first + jnp.arange(AT_ONCE, dtype=jnp.int32)
    end: tuple[Traffic, Rows] = jax.lax.scan(cycle, traffic, numbers)
    return end


def heading_deg(cycle: Int[np.ndarray, " cycles"]) -> Float[np.ndarray, "cycles aircraft"]:
    """The heading after each cycle: a turn by 9 degrees per cycle, except on straight legs."""
    cycle = cycle[:, None]
    circling = 9.0 * cycle
    holding = 180.0 * (cycle // LEG) + np.minimum(9.0 * (cycle % LEG), 180.0)
    right = np.where(HOLDS, holding, circling)
    return np.where(SIDE == RIGHT, right, -right) % 360.0


def level(
    cycle: Int[np.ndarray, " cycles"], rate_ft_min: float
) -> Float[np.ndarray, "cycles aircraft"]:
    """The level after each cycle, in ticks: six seconds of climb per cycle, up to the target."""
    climb = CLIMB_FL * TICKS_PER_FL
    moved = np.minimum(6.0 * rate_ft_min * (cycle % CHANGE), climb)
    # In the cycle of a clearance, the aircraft is still at the previous level.
    up = cycle // CHANGE % 2 == 0
    above = np.where(up, moved, climb - moved)[:, None]
    return LOW_FL * TICKS_PER_FL + np.where(CLIMBS, above, 0.0)


def worst(simulator: Simulator, cycles: int, console: Console) -> dict[str, float]:
    """The largest value of each quantity over `cycles` cycles, rounded up to half days."""
    rate = float(simulator.performance.vertical_speed_ft_min(*jnp.ones((2, 1)))[0])
    compiled = jax.jit(partial(fly, simulator))
    on_equator = begin(simulator, np.zeros(len(PATTERNS)))
    first_lap_nm = compiled(on_equator, jnp.int32(0))[1].position_nm[:LAP]
    # Centre the laps on the equator.
    traffic, lap_nm = begin(simulator, -np.mean(first_lap_nm[..., 1], axis=0)), None
    found = dict.fromkeys(BOUNDS, 0.0)
    for first in track(range(0, cycles, AT_ONCE), console=console):
        traffic, flown = compiled(traffic, jnp.int32(first))
        heading, climb, position = (np.asarray(leaf, dtype=float) for leaf in flown)
        number = np.arange(first, first + AT_ONCE)
        laps = position.reshape(-1, LAP, *position.shape[1:])
        lap_nm = laps[0] if lap_nm is None else lap_nm
        errors = {
            "heading": heading - heading_deg(number),
            "level": climb - level(number, rate),
            "back after a lap": np.hypot(*np.moveaxis(laps - lap_nm, -1, 0)),
        }
        for name, values in errors.items():
            found[name] = float(np.maximum(found[name], np.max(np.abs(values))))  # keeps NaN
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 within all bounds, 1 otherwise."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cycles", type=int, default=DAYS * DAY, help="default: thirty days")
    options = parser.parse_args(arguments)
    console, started, within = Console(stderr=True), time.monotonic(), True
    table = Table("model", "quantity", "bound", "worst", "unit")
    for model, performance in PERFORMANCE.items():
        simulator = Simulator(sector_named("x-plus"), performance)
        for name, value in worst(simulator, options.cycles, console).items():
            bound, unit = BOUNDS[name]
            table.add_row(model, name, f"{bound:g}", f"{value:.2g}", unit)
            within = within and value <= bound
    Console(width=100).print(table)
    console.print(f"{options.cycles:,} cycles of each in {time.monotonic() - started:.0f} s")
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
