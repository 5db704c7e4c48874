"""A job is one seed of one experiment: trained, then evaluated plain and stacked.

The modules `processes` and `cluster` run jobs in parallel.
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
    Conditions,
    Evaluation,
    evaluate,
    evaluate_no_op,
    evaluation_folder,
)
from skystack.evaluation.statistics import MEASURES
from skystack.evaluation.stored import read_table
from skystack.evaluation.summary import NO_OP_NAME, RowValues
from skystack.learning.experiment import Experiment, to_toml
from skystack.learning.policy import Policy, load_policy
from skystack.learning.run import TrainingProgress, train_experiment
from skystack.reproduction.pieces import once
from skystack.reproduction.plan import Plan

TABLES = ("episodes", "aircraft", "trajectories", "clearances")


class EvaluatedRow(NamedTuple):
    """A row of the comparison and the scenarios that it summarises."""

    row: RowValues
    episodes: pa.Table


class JobResult(NamedTuple):
    """The result of a job."""

    train: dict[str, Any]
    """The summary of the training."""
    flown: tuple[EvaluatedRow, ...]
    """The evaluations."""
    kept: tuple[str, ...]
    """The names of the pieces that an earlier run had finished."""


Message = tuple[str, TrainingProgress]
"""The name of a job, and the progress of its training."""
OnProgress = Callable[[str, TrainingProgress], None]
"""Called with the two parts of each message."""


class Job(NamedTuple):
    """An experiment and a seed to train and evaluate; picklable."""

    plan: Plan
    experiment: Experiment
    seed: int

    @property
    def name(self) -> str:
        return f"{self.experiment.name}-s{self.seed}"

    @property
    def folders(self) -> tuple[Path, ...]:
        """All folders that the job writes to."""
        evaluations = (
            evaluation_folder(self.plan.evaluation, self.experiment.name, self.seed, stacking)
            for stacking in (False, True)
        )
        return (self.plan.training(self.name), *evaluations)


def jobs_of(plan: Plan) -> list[Job]:
    """All jobs of a plan, in order."""
    return [
        Job(plan, experiment, seed) for seed in range(plan.seeds) for experiment in plan.experiments
    ]


def longest_first(jobs: Iterable[Job]) -> list[Job]:
    """The jobs in the order to start them, which keeps all cores busy until the end."""
    return sorted(jobs, key=lambda job: -job.experiment.ppo.total_steps)


def run_job(job: Job, put: Callable[[Message], None]) -> JobResult:
    """Train and evaluate; `put` is called with the progress."""
    with kept_programs():
        return _train_and_evaluate(job, put)


def _train_and_evaluate(job: Job, put: Callable[[Message], None]) -> JobResult:
    plan, name = job.plan, job.name
    policy, train, cached = trained_once(
        plan, job.experiment, job.seed, lambda progress: put((name, progress))
    )
    rows, cached_names = [], [f"training {name}"] * cached
    for stacking in (False, True):
        row, cached = flown_once(plan, policy, stacking)
        rows.append(row)
        cached_names += [f"evaluation {name}, {'stacked' if stacking else 'plain'}"] * cached
    return JobResult(train, tuple(rows), tuple(cached_names))


def trained_once(
    plan: Plan, experiment: Experiment, seed: int, on_update: Callable[[TrainingProgress], None]
) -> tuple[Policy, dict[str, Any], bool]:
    """Train a policy, or resume its training, unless it is cached.

    Returns the policy, the summary of its training, and whether it was cached.
    """
    folder = plan.training(f"{experiment.name}-s{seed}")
    config = to_toml(experiment)

    def train() -> dict[str, Any]:
        started = folder / "config.toml"
        resume = started.exists() and started.read_bytes() == config
        every_s = plan.checkpoint_every_s
        try:
            return train_experiment(experiment, seed, folder, resume, on_update, every_s).summary
        except CheckpointError:
            return train_experiment(experiment, seed, folder, False, on_update, every_s).summary

    key = {
        "config": hashlib.sha256(config).hexdigest(),
        "seed": seed,
        "version": skystack.__version__,
    }
    files = ("policy.json", "policy.safetensors", "metrics.jsonl")
    summary, cached = once(folder / "training.json", key, train, files)
    return load_policy(folder), summary, cached


def flown_once(plan: Plan, policy: Policy, stacking: bool) -> tuple[EvaluatedRow, bool]:
    """The evaluation of a policy, and whether it was cached."""
    described, conditions = policy.description, Conditions(episodes=plan.episodes)
    return _evaluated_once(
        plan,
        (described.experiment, described.seed, stacking),
        described.sha256,
        lambda: evaluate(policy, conditions._replace(stacking=stacking), plan.evaluation),
    )


def no_op_once(plan: Plan, experiment: Experiment) -> tuple[EvaluatedRow, bool]:
    """The evaluation of scenarios without instructions, and whether it was cached."""
    conditions = Conditions(episodes=plan.episodes)
    config = hashlib.sha256(to_toml(experiment)).hexdigest()
    return _evaluated_once(
        plan,
        (NO_OP_NAME, 0, False),
        config,
        lambda: evaluate_no_op(experiment, conditions, plan.evaluation),
    )


def _evaluated_once(
    plan: Plan, name: tuple[str, int, bool], what: str, fly: Callable[[], Evaluation]
) -> tuple[EvaluatedRow, bool]:
    folder = evaluation_folder(plan.evaluation, *name)
    key = {"what": what, "episodes": plan.episodes, "version": skystack.__version__}
    files = [f"{table}.parquet" for table in TABLES]
    row, cached = once(folder / "row.json", key, lambda: fly().row, files)
    return EvaluatedRow(row, read_table(folder / "episodes.parquet", EPISODES)), cached


EPISODES: Sequence[str] = (*MEASURES, "min_separation_nm")
"""The columns of `episodes` from which rows are computed."""
