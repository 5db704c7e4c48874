"""Skystack compared with another installed version of it, in one run.

The two versions are measured in turn, group by group (`skystack.benchmarking.groups`): ours,
theirs, theirs, ours. A steady drift of the machine's speed therefore affects both alike.
"""

import statistics
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from skystack.benchmarking.figures import Figure
from skystack.benchmarking.installations import Bench, bench_of, check_python
from skystack.benchmarking.machine import Machine
from skystack.errors import InputError
from skystack.io.json_file import finite


class Measurements(NamedTuple):
    """The measurements of one version, one tuple of values per round."""

    rounds: tuple[tuple[float, ...], ...]

    @property
    def median(self) -> float:
        return statistics.median(value for values in self.rounds for value in values)

    @property
    def finite(self) -> tuple[tuple[float | None, ...], ...]:
        """The values for JSON; None for those that are not finite."""
        return tuple(tuple(map(finite, values)) for values in self.rounds)


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
        """By what factor ours is better, by the medians of all values."""
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
            "values": self.ours.finite,
            "other_values": self.theirs.finite,
            "ratio": finite(self.ratio),
            "ratios": tuple(map(finite, self.ratios)),
            "same_work": self.same_work,
        }


class PairedFigures(NamedTuple):
    """What was measured of both versions."""

    pairs: list[Pair]
    unpaired: list[str]
    """The figures that are not in all runs."""
    machine: Machine
    other_machine: Machine


def compare_with(
    python: str, groups: Sequence[str], options: Sequence[str], on_run: Callable[[str], None]
) -> PairedFigures:
    """Measure groups with our version and with that of another Python.

    `options` are further arguments of `skystack bench`; `on_run` is called with the title of each
    run before it starts. Raises InputError if the other Python has no skystack that can measure
    these groups or if nothing is measured, and TrainingError if a measurement fails.
    """
    check_python(python, groups, options)
    pairs: list[Pair] = []
    unpaired: list[str] = []
    machines: tuple[Machine, ...] = ()
    for group in groups:
        ours, theirs = _in_turn(python, group, options, on_run)
        if theirs:
            machines = ours[0].machine, theirs[0].machine
            found = _paired(ours, theirs)
            names = {each.name for run in (*ours, *theirs) for each in run.figures}
            pairs += found
            unpaired += sorted(names - {pair.name for pair in found})
    if not machines:
        raise InputError(
            "bench: nothing was measured (allowed: groups that this machine can measure)"
        )
    return PairedFigures(pairs, unpaired, *machines)


def _in_turn(
    python: str, group: str, options: Sequence[str], on_run: Callable[[str], None]
) -> tuple[list[Bench], list[Bench]]:
    """The runs of both versions. The other one has none if our first run has no figures.

    Such a group is that of a GPU, on a machine without one.
    """
    ours: list[Bench] = []
    theirs: list[Bench] = []
    for own in (True, False, False, True):
        on_run(f"{group}, {'this version' if own else 'the other version'}")
        runs, interpreter = (ours, None) if own else (theirs, python)
        runs.append(bench_of(interpreter, group, options))
        if not ours[0].figures:
            break
    return ours, theirs


def _paired(our_runs: Sequence[Bench], their_runs: Sequence[Bench]) -> list[Pair]:
    """The figures that all runs have, in our order."""
    ours, theirs = ([_by_name(run) for run in runs] for runs in (our_runs, their_runs))
    return [
        Pair(
            *key,
            Measurements(tuple(run[key].values for run in ours)),
            Measurements(tuple(run[key].values for run in theirs)),
            figure.configuration == theirs[0][key].configuration,
        )
        for key, figure in ours[0].items()
        if all(key in run for run in (*ours, *theirs))
    ]


def _by_name(run: Bench) -> dict[tuple[str, str], Figure]:
    """The figures that have values, by name and unit."""
    return {(each.name, each.unit): each for each in run.figures if each.values}
