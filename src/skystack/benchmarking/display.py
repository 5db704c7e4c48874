"""The figures as tables."""

from collections.abc import Sequence

from skystack.benchmarking.figures import Figure
from skystack.benchmarking.machine import Machine
from skystack.benchmarking.paired import Pair
from skystack.reporting.table import Table


def figures_table(figures: Sequence[Figure]) -> Table:
    """One row per figure: median, range, unit and number of repetitions."""
    lines = tuple(
        (
            figure.name,
            number(figure.median),
            f"{number(min(figure.values))} to {number(max(figure.values))}",
            figure.unit,
            str(len(figure.values)),
        )
        for figure in figures
    )
    return Table(("figure", "median", "range", "unit", "runs"), lines)


def pairs_table(pairs: Sequence[Pair]) -> Table:
    """One row per quantity: both medians, the unit, the ratio, and that of each round."""
    lines = tuple(
        (
            pair.name,
            number(pair.ours.median),
            number(pair.theirs.median),
            pair.unit,
            number(pair.ratio),
            ", ".join(map(number, pair.ratios)),
        )
        for pair in pairs
    )
    return Table(("figure", "this", "other", "unit", "ratio", "in each round"), lines)


def number(value: float) -> str:
    """At least three digits, with no more decimals than these need."""
    size = abs(value)
    return f"{value:,.{0 if size >= 100 else 1 if size >= 10 else 2}f}"


def machine_line(machine: Machine) -> str:
    """The machine in one line."""
    packages = ", ".join(f"{name} {version}" for name, version in machine.packages.items())
    where = f"{machine.processor}, {machine.cores} cores, {machine.system}"
    return f"{where}, Python {machine.python}, {packages}, {machine.date}"
