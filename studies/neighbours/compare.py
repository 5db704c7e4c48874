"""Train and fly every method on every problem, and tabulate the results."""

import re
from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import Any

import skystack
from skystack.compilation.programs import program_cache
from skystack.io.files import make_folder
from skystack.learning.experiment import to_toml
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING, percent
from skystack.reproduction.pieces import once
from studies.neighbours import learner, temporl
from studies.neighbours.flights import fly
from studies.neighbours.methods import (
    METHODS,
    PROBLEMS,
    STACKING,
    VERSION,
    Way,
    build,
    experiment_of,
)
from studies.parallel import run_pieces

SCENARIOS = 1000
Result = dict[str, Any]
"""`cycles_to_good`, `train_s`, and for the name of each way the values of `flights.fly`."""
Results = dict[tuple[str, str], list[Result]]
"""The results of all seeds by problem and method."""
TITLES = {
    ("small changes", Way()): "small changes",
    ("small changes", Way(stacked=True)): "stacking (the paper)",
    ("frozen time", Way(stacked=True)): "stacking, trained in frozen time",
}
"""Row names of the methods with several rows; each other method has one row."""


def measure(problem: str, method: str, seed: int, out: Path) -> Result:
    """Train one policy and fly it in all ways of its method. Finished work in `out` is reused."""
    chosen, cycles = METHODS[method], PROBLEMS[problem].cycles
    experiment = experiment_of(PROBLEMS[problem], chosen)

    def work() -> Result:
        train = temporl.train if chosen.learner == "temporl" else learner.train
        trained = train(chosen, experiment, cycles, seed)
        tasks, rows = build(chosen, experiment), {}
        for way in chosen.ways:
            decide = trained.decide if way.greedy else trained.sample
            rows[way.name] = fly(tasks, decide, trained.weights, way, SCENARIOS)
        return {"cycles_to_good": trained.cycles_to_good, "train_s": trained.train_s, **rows}

    key = {
        "experiment": to_toml(experiment).decode(),
        "cycles": cycles,
        "scenarios": SCENARIOS,
        "ways": [way.name for way in chosen.ways],
        "version": [skystack.__version__, VERSION],
    }
    name = re.sub(r"[^A-Za-z0-9]+", "-", f"{problem} {method} s{seed}") + ".json"
    with program_cache():
        result: Result = once(make_folder(out) / name, key, work)[0]
    return result


def run(problems: Sequence[str], methods: Sequence[str], seeds: int, out: Path) -> Results:
    """All results, one process per core. All methods are run for a seed before the next seed."""
    pieces = [
        (problem, method, seed, out)
        for seed in range(seeds)
        for problem in problems
        for method in methods
        if method in PROBLEMS[problem].methods
    ]
    results: Results = {}
    for piece, result in zip(pieces, run_pieces(measure, pieces, "training runs"), strict=True):
        results.setdefault(piece[:2], []).append(result)
    return results


def table(problem: str, results: Results) -> Table:
    """The methods on one problem. The training time is that of the fastest seed."""
    rows = []
    for (name, method), found in results.items():
        if name != problem:
            continue
        named = {way: title for (each, way), title in TITLES.items() if each == method}
        for way, title in (named or {Way(): method}).items():
            first = [result["cycles_to_good"] for result in found]
            to_good = f"{mean(first) / 1000:.0f} k" if None not in first else NOTHING
            train_s = f"{min(result['train_s'] for result in found):.0f} s"
            rows.append((title, *_cells([result[way.name] for result in found]), to_good, train_s))
    header = ("method", *HEADER, f"cycles to {100.0 * learner.GOOD:.0f} %", "training")
    return Table(header, tuple(rows))


def stacking_table(problem: str, results: Results) -> Table:
    """Stacking in training, at inference, in both or in neither.

    Also with sampled actions, and with clearances checked.
    """
    rows = []
    for method, training in (
        ("small changes", "one action per cycle"),
        ("frozen time", "frozen time"),
    ):
        for way in STACKING if (problem, method) in results else ():
            cells = _cells([result[way.name] for result in results[problem, method]])
            rows.append((training, way.name, *cells))
    return Table(("training", "evaluation", *HEADER), tuple(rows))


HEADER = ("clearances", "learned", "success", "losses")


def _cells(rows: Sequence[dict[str, float]]) -> tuple[str, ...]:
    """Four cells: clearances of the seeds that learned (mean and range), the number of those seeds,
    success over all seeds (mean and lowest), and scenarios with a loss of separation per 1,000.

    A policy that fails often needs few clearances, so its number of clearances says nothing.
    """
    learned = [row for row in rows if row["success_rate"] >= learner.GOOD]
    means = [row["clearances_mean"] for row in learned]
    success = [row["success_rate"] for row in rows]
    losses = mean(row["losses"] for row in rows) * 1000.0 / SCENARIOS
    return (
        f"{mean(means):.1f} ({min(means):.1f} to {max(means):.1f})" if means else NOTHING,
        f"{len(learned)} of {len(rows)}",
        f"{percent(mean(success))} ({percent(min(success))})",
        f"{losses:.1f}",
    )
