"""Readings of the paper: which of the choices that it leaves open leads to its numbers.

    python -m studies.readings [READING ...] [--seeds 3] [--avoidance] [--out DIR]

A reading is a set of choices, `FACTORS`. Each reading trains the paper's policies (undamped,
damped, 37 actions; with `--avoidance` instead the two of lateral navigation and avoidance) and
evaluates them on the same 1,000 held-out scenarios: with the most probable or a sampled action,
unstacked and stacked. The result is a Markdown table, the reading nearest to the paper first.
Finished work in DIR is reused, so the command can be interrupted and repeated. READING is `ours` or
factors joined by `+`; by default all of `READINGS`.

The distance between a reading and the paper was fixed before any reading was trained: the mean of
abs(ln(ours / paper)) over the means and the standard deviations of the paper's rows, values below
0.1 taken as 0.1. It is 0 for the paper's numbers and 0.69 where all are wrong by a factor of two.
"""

import argparse
import json
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from statistics import mean
from typing import NamedTuple

import msgspec
import numpy as np

import skystack
from skystack.compilation.programs import program_cache
from skystack.errors import InputError, checked_integer, unknown_name
from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.paper import PAPER
from skystack.evaluation.summary import RowValues
from skystack.io.files import make_folder
from skystack.learning.experiment import Experiment, load_experiment
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING, mean_and_std, percent
from skystack.reproduction.jobs import Way, train_or_load
from skystack.reproduction.pieces import once
from skystack.reproduction.plan import Plan
from studies.parallel import run_pieces

EPISODES = 1000
LEAST = 0.1
"""Smaller means and standard deviations count as this."""
LATERAL = ("lateral-undamped", "lateral", "lateral-large")
AVOIDANCE = ("avoidance", "avoidance-large")
Rows = dict[tuple[str, int], list[RowValues]]
"""By the name of a variant and its seed: one row for each of `WAYS`."""
UNDAMPED = "lateral-undamped"


class Factor(NamedTuple):
    """A choice that the paper leaves open, made differently than in our experiments."""

    description: str
    changes: tuple[str, ...] = ()
    """Changed settings of all experiments."""
    damped: tuple[str, ...] = ()
    """Changed settings of the damped lateral experiments."""
    avoidance: tuple[str, ...] = ()
    """Changed settings of the avoidance experiments, whose damping has another weight."""


def _damping(description: str, name: str, share: float, *changes: str) -> Factor:
    """A damping term whose weight is a multiple of the paper's."""
    off = ("task.reward.damping=0.0",) if name != "damping" else ()
    lateral = (*off, f"task.reward.{name}={0.25 * share:g}")
    weight = f"{name}={0.3 * share:g}"
    first = ("pretraining.reward.damping=0.0",) if off else ()
    avoidance = (*off, f"task.reward.{weight}", *first, f"pretraining.reward.{weight}")
    return Factor(description, changes, lateral, avoidance)


LEG = 'task.features=["theta_f","theta_sf","d_leg","delta_t"]'
SMALL_UPDATES = ("ppo.environments=16",)
MINIBATCH_64 = ("ppo.minibatch=64",)
UNSCALED = ("ppo.reward_scale=1.0",)
FACTORS = {
    "constant": Factor("400 kt and 2,000 ft/min", ("task.performance=constant",)),
    "small-updates": Factor("2,048 samples per update", SMALL_UPDATES),
    "minibatch-64": Factor("minibatches of 64", MINIBATCH_64),
    "unscaled": Factor("rewards not scaled", UNSCALED),
    "sb3": Factor(
        "the three above, as in Stable-Baselines3", SMALL_UPDATES + MINIBATCH_64 + UNSCALED
    ),
    "raw-observations": Factor(
        "observations not normalised", ("ppo.normalise_observations=false",)
    ),
    "raw-advantages": Factor("advantages not normalised", ("ppo.normalise_advantages=false",)),
    "in-full": _damping("damping paid in full for each aircraft", "damping", 2.0),
    "shared-counter": _damping("one counter of damping", "shared_damping", 1.0),
    "sum": _damping("rewards summed over aircraft", "damping", 2.0, "task.reward.centreline=2.0"),
    "leg": Factor(
        "centreline of the active leg",
        (LEG, "task.reward.centreline=0.0", "task.reward.leg=1.0"),
    ),
    "entered": Factor("instructions only after entry", ("task.control=entered",)),
    "full-time": Factor("scenarios always last 300 cycles", ("task.ends_early=false",)),
    "exit-1": Factor("exit within 1 NM of the fix", ("task.exit_nm=1.0",)),
    "exit-before": Factor("exit 1 NM before the fix", ("task.exit_before_nm=1.0",)),
    "airways": Factor("excursions by airway", ("task.airway_nm=10.0",)),
}
READINGS: tuple[tuple[str, ...], ...] = (
    (),
    *((name,) for name in FACTORS),
    ("constant", "in-full"),
    ("sb3", "constant"),
    ("sb3", "in-full"),
    ("sb3", "constant", "in-full"),
    ("sb3", "constant", "shared-counter"),
    ("sb3", "constant", "raw-observations"),
    ("small-updates", "in-full"),
    ("small-updates", "entered"),
    ("small-updates", "in-full", "entered"),
    ("small-updates", "shared-counter", "entered"),
    ("raw-advantages", "full-time"),
)
"""Each reading as the names of its factors; the first is ours."""
WAYS = tuple(Way(stacking, greedy) for stacking in (False, True) for greedy in (True, False))


def name_of(reading: Sequence[str]) -> str:
    """The name of a reading on the command line."""
    return "+".join(reading) or "ours"


def variant(experiment: str, reading: Sequence[str]) -> Experiment:
    """An experiment under a reading. Its name has only the factors that affect it."""
    changes: list[str] = []
    names = [experiment]
    for name in reading:
        own = _changes(FACTORS[name], experiment)
        changes += own
        names += [name] * bool(own)
    return msgspec.structs.replace(load_experiment(experiment, changes), name=".".join(names))


def _changes(factor: Factor, experiment: str) -> tuple[str, ...]:
    if experiment == UNDAMPED:
        return factor.changes
    if experiment in AVOIDANCE:
        return factor.changes + factor.avoidance
    return factor.changes + factor.damped


def distance(rows: Sequence[tuple[tuple[float, float], tuple[float, float]]]) -> float:
    """The mean of abs(ln(ours / paper)) over pairs of (mean, standard deviation)."""
    ours, paper = (np.maximum(np.array(side), LEAST) for side in zip(*rows, strict=True))
    return float(np.mean(np.abs(np.log(ours / paper))))


def measure(experiment: Experiment, seed: int, out: Path) -> list[RowValues]:
    """Train and evaluate a variant in all `WAYS`: one row each. Finished work in `out` is reused.

    Only the rows are kept: the tables of all flights would take gigabytes.
    """
    plan = Plan((experiment,), 1, EPISODES, out, quick=False, command="")
    with program_cache():
        policy, _, _ = train_or_load(plan, experiment, seed, lambda progress: None)

        def fly() -> list[RowValues]:
            return [
                evaluate(policy, Conditions(0, EPISODES, way.stacking, way.greedy)).row
                for way in WAYS
            ]

        sha256 = policy.description.sha256
        key = {"policy": sha256, "episodes": EPISODES, "version": skystack.__version__}
        record = make_folder(out / "rows") / f"{experiment.name}-s{seed}.json"
        rows: list[RowValues] = once(record, key, fly)[0]
    return rows


def variants(
    readings: Sequence[tuple[str, ...]], experiments: Sequence[str]
) -> dict[str, Experiment]:
    """All variants by name. Readings share those that their factors leave alone."""
    found = (variant(experiment, reading) for reading in readings for experiment in experiments)
    return {each.name: each for each in found}


def run(trained: Collection[Experiment], seeds: int, out: Path) -> Rows:
    """Train and evaluate variants, one process per core, all of a seed before the next seed."""
    pieces = [(each, seed, out) for seed in range(seeds) for each in trained]
    rows = run_pieces(measure, pieces, "training runs")
    return {
        (experiment.name, seed): each
        for (experiment, seed, _), each in zip(pieces, rows, strict=True)
    }


class Score(NamedTuple):
    """The distance of a reading from the paper, and its rows."""

    reading: str
    greedy: bool
    distance: float
    cells: tuple[str, ...]
    success: str
    """The success of the damped policy, stacked, of the seed where it is lowest."""


def scores(
    readings: Sequence[tuple[str, ...]],
    experiments: Sequence[str],
    seeds: int,
    found: Rows,
) -> list[Score]:
    """One score per reading and kind of action, nearest to the paper first."""
    result = []
    for reading in readings:
        for greedy in (True, False):
            pairs, cells, success = [], [], NOTHING
            for (experiment, stacking), paper in PAPER.items():
                if experiment not in experiments:
                    continue
                name, way = variant(experiment, reading).name, WAYS.index(Way(stacking, greedy))
                rows = [found[name, seed][way] for seed in range(seeds)]
                ours = [mean(row[f"clearances_{what}"] for row in rows) for what in ("mean", "std")]
                pairs.append(((ours[0], ours[1]), paper))
                cells.append(mean_and_std(*ours))
                if stacking:  # the paper reports one stacked row, of the damped policy
                    success = percent(min(row["success_rate"] for row in rows))
            result.append(Score(name_of(reading), greedy, distance(pairs), tuple(cells), success))
    return sorted(result, key=lambda score: score.distance)


def table(found: Sequence[Score], experiments: Sequence[str]) -> str:
    """A Markdown table of scores; the first line has the paper's numbers."""
    rows = [name for name in PAPER if name[0] in experiments]
    titles = [f"{name}{', stacked' if stacking else ''}" for name, stacking in rows]
    paper = (mean_and_std(*PAPER[row]) for row in rows)
    lines = [("the paper", NOTHING, NOTHING, *paper, NOTHING)]
    for each in found:
        action = "most probable" if each.greedy else "sampled"
        lines.append((each.reading, action, f"{each.distance:.2f}", *each.cells, each.success))
    header = ("reading", "actions", "distance", *titles, "lowest success")
    return Table(header, tuple(lines)).as_markdown()


def _chosen(names: Sequence[str]) -> list[tuple[str, ...]]:
    """The readings with the given names; any combination of factors is allowed."""
    readings = []
    for name in names:
        factors = () if name == "ours" else tuple(name.split("+"))
        for factor in factors:
            if factor not in FACTORS:
                raise unknown_name("factor", factor, ["ours", *FACTORS])
        readings.append(factors)
    return readings or list(READINGS)


def main() -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[0],
        epilog="factors: " + "; ".join(f"{k}: {each.description}" for k, each in FACTORS.items()),
    )
    parser.add_argument(
        "readings", nargs="*", metavar="READING", help="ours, or factors joined by + (default: all)"
    )
    parser.add_argument("--seeds", type=int, default=3, help="seeds per reading (default 3)")
    parser.add_argument(
        "--avoidance", action="store_true", help="train the avoidance policies instead"
    )
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/readings"), help="folder (default runs/readings)"
    )
    options = parser.parse_args()
    experiments = AVOIDANCE if options.avoidance else LATERAL
    try:
        readings = _chosen(options.readings)
        checked_integer("--seeds", options.seeds, 1)
        trained = variants(readings, experiments).values()
        found = run(trained, options.seeds, options.out)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    ranked = scores(readings, experiments, options.seeds, found)
    if options.json:
        sys.stdout.write(json.dumps([each._asdict() for each in ranked]) + "\n")
    else:
        sys.stdout.write(table(ranked, experiments))
    return 0


if __name__ == "__main__":
    sys.exit(main())
