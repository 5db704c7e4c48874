"""One job is one seed of one experiment: trained, then judged plain and stacked.

Jobs run in processes of their own, one a core.
"""

import hashlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from threading import Thread
from typing import Any, NamedTuple

import pyarrow as pa

import skystack
from skystack.cores import cores
from skystack.errors import InputError
from skystack.evaluation.judge import (
    DO_NOTHING,
    Conditions,
    Judged,
    evaluation_folder,
    judge,
    judge_nobody,
)
from skystack.evaluation.statistics import MEASURES
from skystack.evaluation.stored import read_table
from skystack.evaluation.summary import Row
from skystack.learning.experiment import Experiment, to_toml
from skystack.learning.policy import Policy, load_policy
from skystack.learning.run import Progress, train_experiment
from skystack.programs import kept_programs
from skystack.reproduction.pieces import once
from skystack.reproduction.plan import Plan

TABLES = ("episodes", "aircraft", "trajectories", "clearances")


class Flown(NamedTuple):
    """A row and the scenarios behind it."""

    row: Row
    episodes: pa.Table


class Done(NamedTuple):
    """What a job came to."""

    train: dict[str, Any]
    flown: tuple[Flown, ...]
    kept: tuple[str, ...]
    """Pieces that an earlier run had finished."""


Report = Callable[[str, Progress], None]
Messages = Any
"""A queue of `multiprocessing.Manager` (its proxy is no `Queue`): names with their progress."""


def run_jobs(plan: Plan, report: Report) -> list[Done]:
    """All seeds of all experiments, in order of the plan; their progress goes to `report`."""
    jobs = [(experiment, seed) for seed in range(plan.seeds) for experiment in plan.experiments]
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager:
        messages: Messages = manager.Queue()
        free_cores = manager.Queue()
        for core in cores():
            free_cores.put(core)
        listener = Thread(target=_listen, args=(messages, report), daemon=True)
        listener.start()
        pool = ProcessPoolExecutor(
            min(len(cores()), len(jobs)), context, initializer=_pin, initargs=(free_cores,)
        )
        try:
            # The longest first keeps all cores busy to the end.
            longest_first = sorted(jobs, key=lambda job: -job[0].ppo.total_steps)
            futures = {
                (experiment.name, seed): pool.submit(_run_job, plan, experiment, seed, messages)
                for experiment, seed in longest_first
            }
            return [futures[experiment.name, seed].result() for experiment, seed in jobs]
        except BaseException:
            _stop_workers()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
            messages.put(None)
            listener.join(timeout=5.0)


def _stop_workers() -> None:
    """Do not wait for trainings whose results nobody will read."""
    for child in multiprocessing.active_children():
        if not child.name.startswith("SyncManager"):
            child.terminate()


def _pin(free_cores: Any) -> None:
    """One process, one core: two learners on the same cores slow each other down."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the parent tells of an interruption
    core = free_cores.get()
    if core is not None:
        os.sched_setaffinity(0, {core})


def _listen(messages: Messages, report: Report) -> None:
    while (message := messages.get()) is not None:
        report(*message)


def _run_job(plan: Plan, experiment: Experiment, seed: int, messages: Messages) -> Done:
    with kept_programs():
        return _train_and_judge(plan, experiment, seed, messages)


def _train_and_judge(plan: Plan, experiment: Experiment, seed: int, messages: Messages) -> Done:
    name = f"{experiment.name}-s{seed}"
    policy, train, kept = trained_once(
        plan, experiment, seed, lambda progress: messages.put((name, progress))
    )
    flown, names = [], [f"training {name}"] * kept
    for stacking in (False, True):
        found, kept = flown_once(plan, policy, stacking)
        flown.append(found)
        names += [f"evaluation {name}, {'stacked' if stacking else 'plain'}"] * kept
    return Done(train, tuple(flown), tuple(names))


def trained_once(
    plan: Plan, experiment: Experiment, seed: int, on_update: Callable[[Progress], None]
) -> tuple[Policy, dict[str, Any], bool]:
    """A policy and the summary of its training; trained, or gone on with, unless it was before."""
    folder = plan.training(f"{experiment.name}-s{seed}")
    config = to_toml(experiment)

    def train() -> dict[str, Any]:
        begun = folder / "config.toml"
        same = begun.exists() and begun.read_bytes() == config
        try:
            return train_experiment(experiment, seed, folder, same, on_update).summary
        except InputError:
            if not same:
                raise
            # What an earlier run left cannot be gone on with.
            return train_experiment(experiment, seed, folder, False, on_update).summary

    key = {
        "config": hashlib.sha256(config).hexdigest(),
        "seed": seed,
        "version": skystack.__version__,
    }
    files = ("policy.json", "policy.safetensors", "metrics.jsonl")
    summary, kept = once(folder / "training.json", key, train, files)
    return load_policy(folder), summary, kept


def flown_once(plan: Plan, policy: Policy, stacking: bool) -> tuple[Flown, bool]:
    """A policy judged, unless it was before."""
    described, conditions = policy.description, Conditions(episodes=plan.episodes)
    return _judged_once(
        plan,
        (described.experiment, described.seed, stacking),
        described.sha256,
        lambda: judge(policy, conditions._replace(stacking=stacking), plan.evaluation),
    )


def nobody_once(plan: Plan, experiment: Experiment) -> tuple[Flown, bool]:
    """The scenarios of an experiment with no instructions at all, unless flown before."""
    conditions = Conditions(episodes=plan.episodes)
    config = hashlib.sha256(to_toml(experiment)).hexdigest()
    return _judged_once(
        plan,
        (DO_NOTHING, 0, False),
        config,
        lambda: judge_nobody(experiment, conditions, plan.evaluation),
    )


def _judged_once(
    plan: Plan, name: tuple[str, int, bool], what: str, fly: Callable[[], Judged]
) -> tuple[Flown, bool]:
    folder = evaluation_folder(plan.evaluation, *name)
    key = {"what": what, "episodes": plan.episodes, "version": skystack.__version__}
    files = [f"{table}.parquet" for table in TABLES]
    row, kept = once(folder / "row.json", key, lambda: fly().row, files)
    return Flown(row, read_table(folder / "episodes.parquet", EPISODES)), kept


EPISODES: Sequence[str] = (*MEASURES, "min_separation_nm")
"""The columns that rows are made from."""
