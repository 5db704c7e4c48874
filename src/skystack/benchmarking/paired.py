"""Skystack compared with another installed version of it, in one run.

The two versions are measured in turn, group by group (`skystack.benchmarking.groups`): ours,
theirs, theirs, ours. So a steady drift of the machine's speed affects both alike.
"""

import math
import statistics
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec

from skystack.benchmarking.figures import finite_or_none
from skystack.benchmarking.installations import Bench, MeasuredFigure, bench_of, check_python
from skystack.errors import InputError


class Measurements(NamedTuple):
    """The measurements of one version, one tuple of values per round."""

    rounds: tuple[tuple[float, ...], ...]

    @property
    def median(self) -> float:
        return statistics.median(value for values in self.rounds for value in values)


class Pair(NamedTuple):
    """A quantity that was measured in both versions."""

    name: str
    unit: str
    ours: Measurements
    theirs: Measurements
    same_work: bool = True
    """Whether both versions describe the configuration in the same words."""

    @property
    def ratio(self) -> float:
        """How many times as good ours is, by the medians of all values."""
        return self._ratio(self.ours.median, self.theirs.median)

    @property
    def ratios(self) -> tuple[float, ...]:
        """The ratio in each round."""
        rounds = zip(self.ours.rounds, self.theirs.rounds, strict=True)
        return tuple(
            self._ratio(statistics.median(ours), statistics.median(theirs))
            for ours, theirs in rounds
        )

    def _ratio(self, ours: float, theirs: float) -> float:
        """More is better for rates, less for times and memory."""
        return ours / theirs if self.unit.endswith("/s") else theirs / ours

    @property
    def as_json(self) -> dict[str, Any]:
        """All values, the ratio and that of each round; None for what is not finite."""
        return {
            "name": self.name,
            "unit": self.unit,
            "values": finite_or_none(self.ours.rounds),
            "other_values": finite_or_none(self.theirs.rounds),
            "ratio": finite_or_none(self.ratio),
            "ratios": finite_or_none(self.ratios),
            "same_work": self.same_work,
        }


class PairedFigures(NamedTuple):
    """What was measured of both versions."""

    pairs: list[Pair]
    unpaired: list[str]
    """The figures that not all runs have."""
    machine: dict[str, Any]
    other_machine: dict[str, Any]


def compare_with(
    python: str, groups: Sequence[str], options: Sequence[str], on_run: Callable[[str], None]
) -> PairedFigures:
    """Measure groups with our version and with that of another Python.

    `options` are further arguments of `skystack bench`; `on_run` is called with the title of each
    run before it starts. Raises InputError if the other Python has no skystack that can measure
    these groups, and TrainingError if a measurement fails.
    """
    check_python(python, groups, options)
    pairs: list[Pair] = []
    unpaired: list[str] = []
    machines: list[dict[str, Any]] = []
    for group in groups:
        our_runs, their_runs = list[Bench](), list[Bench]()
        for interpreter, runs, whose in (
            (None, our_runs, "this version"),
            (python, their_runs, "the other version"),
            (python, their_runs, "the other version"),
            (None, our_runs, "this version"),
        ):
            on_run(f"{group}, {whose}")
            runs.append(bench_of(interpreter, group, options))
            if not our_runs[0].figures:
                break  # such as those of a GPU, on a machine without one
        if not their_runs:
            continue
        found = _paired(our_runs, their_runs)
        paired = {pair.name for pair in found}
        names = {each.name for run in (*our_runs, *their_runs) for each in run.figures}
        pairs += found
        unpaired += sorted(names - paired)
        machines = [msgspec.to_builtins(runs[0].machine) for runs in (our_runs, their_runs)]
    if not machines:
        raise InputError(
            "bench: nothing was measured (allowed: groups that this machine can measure)"
        )
    return PairedFigures(pairs, unpaired, *machines)


def _paired(our_runs: Sequence[Bench], their_runs: Sequence[Bench]) -> list[Pair]:
    """The figures that all runs have, in our order."""
    pairs = []
    ours, theirs = ([_by_name(run) for run in runs] for runs in (our_runs, their_runs))
    for key, figure in ours[0].items():
        if all(key in run and run[key].values for run in (*ours, *theirs)):
            mine, other = (_values([run[key] for run in runs]) for runs in (ours, theirs))
            same = theirs[0][key].configuration == figure.configuration
            pairs.append(Pair(*key, mine, other, same))
    return pairs


def _by_name(run: Bench) -> dict[tuple[str, str], MeasuredFigure]:
    return {(each.name, each.unit): each for each in run.figures}


def _values(figures: Sequence[MeasuredFigure]) -> Measurements:
    return Measurements(
        tuple(
            tuple(math.inf if value is None else value for value in each.values) for each in figures
        )
    )
