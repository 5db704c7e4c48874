"""Skystack compared with another installed version of it, in one run.

The two versions are measured in turn, group by group (`skystack.benchmarking.figures.GROUPS`):
ours, theirs, theirs, ours. So both meet the same changes of the machine's speed, such as those that
other programs and heat cause.
"""

import math
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec

from skystack.benchmarking.figures import finite
from skystack.errors import InputError

_VARIABLES = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
"""Environment variables that could make the other Python import our packages."""


class Side(NamedTuple):
    """The measurements of one version, one tuple of values per round."""

    rounds: tuple[tuple[float, ...], ...]

    @property
    def median(self) -> float:
        return statistics.median(value for values in self.rounds for value in values)


class Pair(NamedTuple):
    """A quantity that was measured in both versions."""

    name: str
    unit: str
    ours: Side
    theirs: Side

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
        """All values, the ratio and that of each round."""
        return {
            "name": self.name,
            "unit": self.unit,
            "values": finite(self.ours.rounds),
            "other_values": finite(self.theirs.rounds),
            "ratio": finite(self.ratio),
            "ratios": finite(self.ratios),
        }


class _Figure(msgspec.Struct):
    name: str
    unit: str
    values: tuple[float | None, ...]
    """None for training runs that did not reach success."""


class _Bench(msgspec.Struct):
    """The JSON of `skystack bench`, as far as it is needed."""

    machine: dict[str, Any]
    figures: list[_Figure]


class Compared(NamedTuple):
    """The pairs, what only one of the two versions measures, and the other's machine."""

    pairs: list[Pair]
    unpaired: list[str]
    other_machine: dict[str, Any]


def compare_with(
    python: str, groups: Sequence[str], options: Sequence[str], on_run: Callable[[str], None]
) -> Compared:
    """Measure groups with our version and with that of another Python.

    `options` are further arguments of `skystack bench`; `on_run` is called with the title of each
    run before it starts. Raises InputError if the other Python cannot measure.
    """
    _check(python)
    pairs: list[Pair] = []
    unpaired: list[str] = []
    machine: dict[str, Any] = {}
    for group in groups:
        runs: dict[bool, list[_Bench]] = {True: [], False: []}
        for ours in (True, False, False, True):
            on_run(f"{group}, {'this version' if ours else 'the other version'}")
            runs[ours].append(_measured(None if ours else python, group, options))
        machine = runs[False][0].machine
        ours_by_name, theirs_by_name = (_sides(runs[ours]) for ours in (True, False))
        for (name, unit), side in ours_by_name.items():
            other = theirs_by_name.get((name, unit))
            if other is not None:
                pairs.append(Pair(name, unit, side, other))
        unpaired += [name for name, _ in ours_by_name.keys() ^ theirs_by_name.keys()]
    return Compared(pairs, sorted(unpaired), machine)


def _sides(runs: Sequence[_Bench]) -> dict[tuple[str, str], Side]:
    """The values of each figure that all runs have."""
    by_run = [
        {
            (each.name, each.unit): tuple(math.inf if v is None else v for v in each.values)
            for each in run.figures
        }
        for run in runs
    ]
    return {
        key: Side(tuple(found[key] for found in by_run))
        for key in by_run[0]
        if all(found.get(key) for found in by_run)
    }


def _measured(python: str | None, group: str, options: Sequence[str]) -> _Bench:
    """What `skystack bench` prints of a group; with None, that of our own Python."""
    done = _run(python, "--json", *options, "--only", group)
    where = f"bench --only {group}" if python is None else f"--against {python}"
    if done.returncode:
        raise InputError(f"{where}: exit code {done.returncode} while {group} was measured")
    try:
        return msgspec.json.decode(done.stdout, type=_Bench)
    except msgspec.MsgspecError as error:
        raise InputError(f"{where}: not the JSON of `skystack bench`: {error}") from None


def _check(python: str) -> None:
    """Raises InputError unless a Python has a skystack that can be measured group by group."""
    try:
        done = _run(python, "--help", stderr=subprocess.PIPE)
    except OSError as error:
        raise InputError(f"--against {python}: {error.strerror}") from None
    if done.returncode or "--only" not in done.stdout:
        (*_, reason) = ["no `bench --only`", *(done.stderr or "").strip().splitlines()]
        raise InputError(
            f"--against {python}: {reason} (allowed: the Python of an environment with a skystack "
            "that has `bench --only`)"
        )


def _run(
    python: str | None, *arguments: str, stderr: int | None = None
) -> subprocess.CompletedProcess[str]:
    """Run `skystack bench` with our own Python (None) or another one."""
    environment = dict(os.environ)
    if python is not None:
        for name in _VARIABLES:
            environment.pop(name, None)
    # With -P, a folder named skystack in the current folder is not taken for the package.
    command = [python or sys.executable, "-P", "-m", "skystack", "bench", *arguments]
    return subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, stderr=stderr, text=True, check=False
    )
