"""One job is one seed of one experiment: trained, then judged plain and stacked.

Which process runs it, and where, is the business of `processes` and `cluster`.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

import skystack
from skystack.compilation.programs import kept_programs
from skystack.errors import CheckpointError
from skystack.evaluation.evaluate import (
    NO_OP_NAME,
    Conditions,
    Evaluation,
    evaluate,
    evaluate_no_op,
    evaluation_folder,
)
from skystack.evaluation.statistics import MEASURES
from skystack.evaluation.stored import read_table
from skystack.evaluation.summary import RowValues
from skystack.learning.experiment import Experiment, to_toml
from skystack.learning.policy import Policy, load_policy
from skystack.learning.run import Progress, train_experiment
from skystack.reproduction.pieces import once
from skystack.reproduction.plan import Plan

TABLES = ("episodes", "aircraft", "trajectories", "clearances")


class EvaluatedRow(NamedTuple):
    """A row and the scenarios behind it."""

    row: RowValues
    episodes: pa.Table


class JobResult(NamedTuple):
    """What a job came to."""

    train: dict[str, Any]
    flown: tuple[EvaluatedRow, ...]
    kept: tuple[str, ...]
    """Pieces that an earlier run had finished."""


Message = tuple[str, Progress]
"""How far the job of that name is."""
OnProgress = Callable[[str, Progress], None]
"""Hears messages."""


class Job(NamedTuple):
    """What to train and judge; picklable."""

    plan: Plan
    experiment: Experiment
    seed: int

    @property
    def name(self) -> str:
        return f"{self.experiment.name}-s{self.seed}"

    @property
    def folders(self) -> tuple[Path, ...]:
        """All that it writes to."""
        judged = (
            evaluation_folder(self.plan.evaluation, self.experiment.name, self.seed, stacking)
            for stacking in (False, True)
        )
        return (self.plan.training(self.name), *judged)


def jobs_of(plan: Plan) -> list[Job]:
    """All jobs of a plan, in its order."""
    return [
        Job(plan, experiment, seed) for seed in range(plan.seeds) for experiment in plan.experiments
    ]


def longest_first(jobs: Iterable[Job]) -> list[Job]:
    """The order to begin them in: it keeps all cores busy to the end."""
    return sorted(jobs, key=lambda job: -job.experiment.ppo.total_steps)


def run_job(job: Job, put: Callable[[Message], None]) -> JobResult:
    """Train and judge; `put` hears of the progress."""
    with kept_programs():
        return _train_and_judge(job, put)


def _train_and_judge(job: Job, put: Callable[[Message], None]) -> JobResult:
    plan, name = job.plan, job.name
    policy, train, kept = trained_once(
        plan, job.experiment, job.seed, lambda progress: put((name, progress))
    )
    flown, names = [], [f"training {name}"] * kept
    for stacking in (False, True):
        found, kept = flown_once(plan, policy, stacking)
        flown.append(found)
        names += [f"evaluation {name}, {'stacked' if stacking else 'plain'}"] * kept
    return JobResult(train, tuple(flown), tuple(names))


def trained_once(
    plan: Plan, experiment: Experiment, seed: int, on_update: Callable[[Progress], None]
) -> tuple[Policy, dict[str, Any], bool]:
    """A policy and the summary of its training; trained, or gone on with, unless it was before."""
    folder = plan.training(f"{experiment.name}-s{seed}")
    config = to_toml(experiment)

    def train() -> dict[str, Any]:
        begun = folder / "config.toml"
        same = begun.exists() and begun.read_bytes() == config
        every_s = plan.checkpoint_every_s
        try:
            return train_experiment(experiment, seed, folder, same, on_update, every_s).summary
        except CheckpointError:
            return train_experiment(experiment, seed, folder, False, on_update, every_s).summary

    key = {
        "config": hashlib.sha256(config).hexdigest(),
        "seed": seed,
        "version": skystack.__version__,
    }
    files = ("policy.json", "policy.safetensors", "metrics.jsonl")
    summary, kept = once(folder / "training.json", key, train, files)
    return load_policy(folder), summary, kept


def flown_once(plan: Plan, policy: Policy, stacking: bool) -> tuple[EvaluatedRow, bool]:
    """A policy judged, unless it was before."""
    described, conditions = policy.description, Conditions(episodes=plan.episodes)
    return _judged_once(
        plan,
        (described.experiment, described.seed, stacking),
        described.sha256,
        lambda: evaluate(policy, conditions._replace(stacking=stacking), plan.evaluation),
    )


def no_op_once(plan: Plan, experiment: Experiment) -> tuple[EvaluatedRow, bool]:
    """The scenarios of an experiment with no instructions at all, unless flown before."""
    conditions = Conditions(episodes=plan.episodes)
    config = hashlib.sha256(to_toml(experiment)).hexdigest()
    return _judged_once(
        plan,
        (NO_OP_NAME, 0, False),
        config,
        lambda: evaluate_no_op(experiment, conditions, plan.evaluation),
    )


def _judged_once(
    plan: Plan, name: tuple[str, int, bool], what: str, fly: Callable[[], Evaluation]
) -> tuple[EvaluatedRow, bool]:
    folder = evaluation_folder(plan.evaluation, *name)
    key = {"what": what, "episodes": plan.episodes, "version": skystack.__version__}
    files = [f"{table}.parquet" for table in TABLES]
    row, kept = once(folder / "row.json", key, lambda: fly().row, files)
    return EvaluatedRow(row, read_table(folder / "episodes.parquet", EPISODES)), kept


EPISODES: Sequence[str] = (*MEASURES, "min_separation_nm")
"""The columns that rows are made from."""
