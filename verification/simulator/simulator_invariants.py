"""Fly random worlds and check the simulator's invariants in every cycle.

    python -m verification.simulator.simulator_invariants [--count N] [--seed S] [--seconds LIMIT]
        [--world NUMBER]

A cycle is one `advance` of one world of 1 to 12 aircraft; the flights that it is compared with are
not counted. World i depends only on the seed and i, and `--world` flies it alone. Prints for every
invariant the number of checks, its bound and the worst value. A value beyond its bound is a
finding, printed with its world, cycle and aircraft. Exit code 1 if there are findings.
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from verification.simulator.compared_flights import BOUNDS as COMPARED
from verification.simulator.compared_flights import comparisons, draw_change
from verification.simulator.invariants import BOUNDS as ALONE
from verification.simulator.invariants import Quantities, invariants
from verification.simulator.random_worlds import (
    CYCLES,
    SETTINGS,
    Flier,
    Setting,
    concatenate_worlds,
    draw,
    setting_of,
)

BOUNDS = {**ALONE, **COMPARED}
MAX_AT_ONCE = 256
SHOWN = 5
"""The number of findings that are printed for each invariant."""


class Finding(NamedTuple):
    """A value beyond its bound."""

    world: int
    cycle: int
    aircraft: int
    value: float


@dataclass
class Tally:
    """The results of one invariant."""

    checked: int = 0
    """The number of checked values, one per aircraft and cycle."""
    worst: float = -math.inf
    findings: list[Finding] = field(default_factory=list)


Tallies = dict[str, Tally]


def try_worlds(flier: Flier, numbers: Sequence[int], seed: int, tallies: Tallies) -> None:
    """Fly worlds of the flier's setting, and add the results to the tallies."""
    world = concatenate_worlds([draw(seed, number) for number in numbers])
    aircraft = world.start.level_ticks.shape[0]
    change = concatenate_worlds([draw_change(seed, number, aircraft) for number in numbers])
    flown = flier.fly(world)
    plane = flier.simulator.sector.plane
    check(invariants(flown, world.clearances, flier.limits, plane), numbers, tallies)
    check(comparisons(flier, world, flown, change), numbers, tallies)


def check(quantities: Quantities, numbers: Sequence[int], tallies: Tallies) -> None:
    """Add quantities to the tallies; values beyond their bound, and NaN, are findings."""
    for name, (values, where) in quantities.items():
        tally = tallies.setdefault(name, Tally())
        tally.checked += int(where.sum())
        if where.any():
            tally.worst = float(np.fmax(tally.worst, np.max(values[where])))
        for at in np.argwhere(where & ~(values <= BOUNDS[name].most)):
            cycle, aircraft, world = at.tolist()
            tally.findings.append(Finding(numbers[world], cycle, aircraft, float(values[*at])))


def batches(count: int) -> list[range]:
    """The numbers of the worlds for at least `count` cycles, in batches of one setting each."""
    each = math.ceil(count / CYCLES / len(SETTINGS))
    rounds = math.ceil(each / MAX_AT_ONCE)
    size = math.ceil(each / rounds)  # the same for all: as many programs as settings
    step = len(SETTINGS)
    return [
        range(setting + turn * size * step, (turn + 1) * size * step, step)
        for turn in range(rounds)
        for setting in range(step)
    ]


def as_table(tallies: Tallies) -> Table:
    """The tallies as a table."""
    table = Table("invariant", "checked", "bound", "worst", "unit", "findings")
    for column in table.columns[1:4]:
        column.justify = "right"
    for name, tally in tallies.items():
        bound, worst = BOUNDS[name], f"{tally.worst:.2g}" if tally.checked else "-"
        found = f"{len(tally.findings):,}"
        table.add_row(name, f"{tally.checked:,}", f"{bound.most:g}", worst, bound.unit, found)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 no findings, 1 findings."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=20_000, help="cycles (default 20,000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after this time")
    parser.add_argument("--world", type=int, help="fly only the world with this number")
    options = parser.parse_args(arguments)
    console, started = Console(stderr=True), time.monotonic()
    alone = options.world is not None
    work = [range(options.world, options.world + 1)] if alone else batches(options.count)
    fliers: dict[Setting, Flier] = {}
    tallies: Tallies = {}
    worlds = 0
    with Progress(console=console) as bars:
        bar = bars.add_task("worlds", total=sum(len(numbers) for numbers in work))
        for numbers in work:
            if time.monotonic() - started > options.seconds:
                break
            setting = setting_of(numbers[0])
            if setting not in fliers:
                fliers[setting] = Flier(setting)
            try_worlds(fliers[setting], numbers, options.seed, tallies)
            worlds += len(numbers)
            bars.update(bar, completed=worlds)
    for name, tally in tallies.items():
        for found in tally.findings[:SHOWN]:
            where = f"world {found.world}, cycle {found.cycle}, aircraft {found.aircraft}"
            console.print(f"{name}: seed {options.seed}, {where}: {found.value}", highlight=False)
    Console(width=110).print(as_table(tallies))
    wall_s = time.monotonic() - started
    console.print(f"{worlds * CYCLES:,} cycles of {worlds:,} worlds in {wall_s:.0f} s")
    return 1 if any(tally.findings for tally in tallies.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
