"""Jobs: train and evaluate one seed, evaluate a shipped policy, or evaluate doing nothing.

The modules `processes` and `cluster` run jobs in parallel.
"""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import pyarrow as pa

import skystack
from skystack.compilation.programs import program_cache
from skystack.errors import CheckpointError
from skystack.evaluation.evaluate import (
    Conditions,
    Evaluation,
    evaluate,
    evaluate_no_op,
)
from skystack.evaluation.statistics import MEASURES
from skystack.evaluation.stored import read_table
from skystack.evaluation.summary import (
    RowValues,
    evaluation_folder,
    no_op_name,
    shipped_name,
)
from skystack.evaluation.tabulate import TABLES
from skystack.learning.experiment import Experiment, to_toml
from skystack.learning.policy import Policy, load_policy
from skystack.learning.progress import TrainingProgress
from skystack.learning.run import train_experiment
from skystack.policies.shipped import find_policy
from skystack.reproduction.pieces import once
from skystack.reproduction.plan import Plan


class Way(NamedTuple):
    """How a policy is flown."""

    stacking: bool
    greedy: bool
    """Whether it takes the most probable action; otherwise it samples one."""

    @property
    def words(self) -> str:
        return f"{'stacked' if self.stacking else 'plain'}{'' if self.greedy else ', sampled'}"


class EvaluatedRow(NamedTuple):
    """A row of the comparison and the scenarios that it summarises."""

    row: RowValues
    episodes: pa.Table


class JobResult(NamedTuple):
    """The result of a job."""

    train: dict[str, Any] | None
    """The summary of the training, if the job trains."""
    flown: tuple[EvaluatedRow, ...]
    """The evaluations."""
    kept: tuple[str, ...]
    """The names of the pieces that an earlier run had finished."""


Phase = Literal["evaluating", "done"]
Message = tuple[str, TrainingProgress | Phase]
"""The name of a job, and the progress of its training or the phase that begins."""
OnProgress = Callable[[str, TrainingProgress | Phase], None]
"""Called with the two parts of each message."""


class Job(NamedTuple):
    """A unit of work of a reproduction, run by one process; picklable."""

    plan: Plan
    experiment: Experiment
    seed: int
    """The training seed; 0 if the job does not train."""
    kind: Literal["train", "shipped", "no-op"] = "train"
    """Train the experiment and evaluate the policy in all `ways`; evaluate the policy shipped for
    the experiment, stacked; or evaluate the experiment's scenarios without instructions."""

    @property
    def name(self) -> str:
        if self.kind == "no-op":
            return no_op_name(self.experiment.task.name)
        if self.kind == "shipped":
            return shipped_name(self.experiment.name)
        return f"{self.experiment.name}-s{self.seed}"

    @property
    def ways(self) -> tuple[Way, ...]:
        """How a trained policy is flown."""
        kinds = (True, False) if self.plan.with_sampled else (True,)
        return tuple(Way(stacking, greedy) for greedy in kinds for stacking in (False, True))

    @property
    def folders(self) -> tuple[Path, ...]:
        """All folders that the job writes to."""
        evaluation = self.plan.evaluation
        if self.kind == "no-op":
            return (evaluation_folder(evaluation, self.name, 0, False),)
        if self.kind == "shipped":
            seed = find_policy(self.experiment.name).description.seed
            return (evaluation_folder(evaluation, self.name, seed, True),)
        evaluations = (
            evaluation_folder(
                evaluation, self.experiment.name, self.seed, way.stacking, greedy=way.greedy
            )
            for way in self.ways
        )
        return (self.plan.training(self.name), *evaluations)


def jobs_of(plan: Plan) -> list[Job]:
    """All jobs of a plan, in order."""
    first_of_task = {each.task.name: each for each in reversed(plan.experiments)}
    return [
        *(Job(plan, each, seed) for seed in range(plan.seeds) for each in plan.experiments),
        *(Job(plan, each, 0, "shipped") for each in plan.experiments if plan.with_shipped),
        *(Job(plan, each, 0, "no-op") for each in reversed(first_of_task.values())),
    ]


def longest_first(jobs: Iterable[Job]) -> list[Job]:
    """The jobs in the order to start them, which keeps all cores busy until the end."""
    return sorted(jobs, key=lambda job: (job.kind != "train", -job.experiment.ppo.total_steps))


def run_job(job: Job, put: Callable[[Message], None]) -> JobResult:
    """Run a job; `put` is called with each message."""
    with program_cache():
        result = _RUN[job.kind](job, put)
    put((job.name, "done"))
    return result


def _train_and_evaluate(job: Job, put: Callable[[Message], None]) -> JobResult:
    plan, name = job.plan, job.name
    policy, train, cached = train_or_load(
        plan, job.experiment, job.seed, lambda progress: put((name, progress))
    )
    put((name, "evaluating"))
    rows, cached_names = [], [f"training {name}"] * cached
    for way in job.ways:
        row, cached = evaluate_or_load(plan, policy, way)
        rows.append(row)
        cached_names += [f"evaluation {name}, {way.words}"] * cached
    return JobResult(train, tuple(rows), tuple(cached_names))


def _evaluate_shipped(job: Job, put: Callable[[Message], None]) -> JobResult:
    put((job.name, "evaluating"))
    policy = find_policy(job.experiment.name)
    row, cached = evaluate_or_load(job.plan, policy, Way(True, True), job.name)
    return JobResult(None, (row,), (f"evaluation {job.name}",) * cached)


def _evaluate_no_op(job: Job, put: Callable[[Message], None]) -> JobResult:
    put((job.name, "evaluating"))
    row, cached = evaluate_no_op_or_load(job.plan, job.experiment)
    return JobResult(None, (row,), (f"evaluation {job.name}",) * cached)


_RUN = {"train": _train_and_evaluate, "shipped": _evaluate_shipped, "no-op": _evaluate_no_op}


def train_or_load(
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


def evaluate_or_load(
    plan: Plan, policy: Policy, way: Way, name: str | None = None
) -> tuple[EvaluatedRow, bool]:
    """The evaluation of a policy, and whether it was cached.

    `name` is that of the row; by default that of the policy's experiment.
    """
    described = policy.description
    conditions = Conditions(episodes=plan.episodes, stacking=way.stacking, greedy=way.greedy)
    return _evaluate_or_load(
        plan,
        (name or described.experiment, described.seed),
        way,
        described.sha256,
        lambda: evaluate(policy, conditions, plan.evaluation, name=name),
    )


def evaluate_no_op_or_load(plan: Plan, experiment: Experiment) -> tuple[EvaluatedRow, bool]:
    """The evaluation of scenarios without instructions, and whether it was cached."""
    conditions = Conditions(episodes=plan.episodes)
    config = hashlib.sha256(to_toml(experiment)).hexdigest()
    return _evaluate_or_load(
        plan,
        (no_op_name(experiment.task.name), 0),
        Way(False, True),
        config,
        lambda: evaluate_no_op(experiment, conditions, plan.evaluation),
    )


def _evaluate_or_load(
    plan: Plan, name: tuple[str, int], way: Way, what: str, fly: Callable[[], Evaluation]
) -> tuple[EvaluatedRow, bool]:
    folder = evaluation_folder(plan.evaluation, *name, way.stacking, greedy=way.greedy)
    key = {
        "what": what,
        "episodes": plan.episodes,
        "version": skystack.__version__,
        "columns": list(EPISODES),  # a piece of an older version may lack some
    }
    files = [f"{table}.parquet" for table in TABLES]
    row, cached = once(folder / "row.json", key, lambda: fly().row, files)
    return EvaluatedRow(row, read_table(folder / "episodes.parquet", EPISODES)), cached


EPISODES: Sequence[str] = (*MEASURES, "min_separation_nm", "exits", "exit_offset_nm")
"""The columns of `episodes` from which rows are computed."""
