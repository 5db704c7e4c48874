"""Judge one controller on held-out scenarios: fly, write the tables, reduce them to a row."""

from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from skystack.errors import InputError
from skystack.evaluation.rollout import NOBODY, Recording, fly, network_controller
from skystack.evaluation.summary import Row, summarise
from skystack.evaluation.tables import make_tables
from skystack.learning.experiment import Experiment, experiment_from
from skystack.learning.policy import Policy
from skystack.tasks.build import build_task
from skystack.tasks.lateral import LateralTask

PLATFORM = "skystack"
DO_NOTHING = "do-nothing"


class Judged(NamedTuple):
    """A row and the scenarios behind it."""

    row: Row
    episodes: pa.Table


def task_of(policy: Policy) -> LateralTask:
    """The task that a policy was trained for, as it is flown.

    Raises InputError when this version's task is another one than the policy's.
    """
    described = policy.description
    where = f"policy {described.experiment}-s{described.seed}"
    experiment: Experiment = experiment_from(described.config, where)
    task = build_task(experiment.task)
    if (described.task_name, described.task_version) != (task.name, task.version):
        raise InputError(
            f"{where} was trained for task {described.task_name} version "
            f"{described.task_version} (allowed: {task.name} version {task.version}); train it anew"
        )
    if described.observation != task.observation_names or described.actions != task.action_names:
        raise InputError(f"{where}: its observation or actions are not those of its task")
    return task


def judge(
    policy: Policy, seed: int, episodes: int, stacking: bool, greedy: bool, out: Path | None
) -> Judged:
    """Fly a policy on the scenarios of an evaluation seed; `out` is the folder for evaluations."""
    described, task = policy.description, task_of(policy)
    controller = network_controller(policy.actor, policy.normaliser, greedy)
    flight = fly(task, controller, seed, episodes, stacking)
    return _reduce(described.experiment, described.seed, task, flight, stacking, greedy, out)


def judge_nobody(experiment: Experiment, seed: int, episodes: int, out: Path | None) -> Judged:
    """The same scenarios with no instructions at all."""
    task = build_task(experiment.task)
    flight = fly(task, NOBODY, seed, episodes, stacking=False)
    return _reduce(DO_NOTHING, 0, task, flight, stacking=False, greedy=True, out=out)


def evaluation_folder(out: Path, experiment: str, seed: int, stacking: bool) -> Path:
    """Where the tables of an evaluation lie."""
    kind = "stacked" if stacking else "plain"
    return out / f"{experiment}-s{seed}-{PLATFORM}-{kind}"


def _reduce(
    name: str,
    trained_seed: int,
    task: LateralTask,
    flight: Recording,
    stacking: bool,
    greedy: bool,
    out: Path | None,
) -> Judged:
    """Tables, written where wanted, and the row."""
    tables = make_tables(task, flight)
    if out is not None:
        folder = evaluation_folder(out, name, trained_seed, stacking)
        tables.write(folder, task.simulator.sector)
    row = summarise(name, trained_seed, PLATFORM, stacking, greedy, tables.episodes)
    return Judged(row, tables.episodes)
