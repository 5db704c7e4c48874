"""Reproduce the paper: train, evaluate with and without stacking, compare, report.

One job is one seed of one experiment; jobs run in processes of their own, one a core.
"""

import json
import multiprocessing
import os
import platform
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa

import skystack
from skystack.cores import cores
from skystack.errors import unknown_name
from skystack.evaluation.everywhere import Count, judge_everywhere
from skystack.evaluation.judge import Conditions, Judged, judge, judge_nobody
from skystack.evaluation.summary import Row, aggregate
from skystack.files import make_folder, write_aside
from skystack.learning.experiment import Experiment, load_experiment
from skystack.learning.policy import load_policy
from skystack.learning.run import Progress, train_experiment
from skystack.platforms.registry import OWN, check_platform

FAMILIES = {
    "lateral": ("lateral-best", "lateral-large", "lateral-tuned", "lateral", "lateral-undamped"),
    "vertical": ("vertical",),
    "avoidance": ("avoidance-best", "avoidance-large", "avoidance"),
}
"""Experiments of each family; longest training first keeps all cores busy to the end."""

QUICK_STEPS = 500_000
QUICK_EPISODES = 200
PLATFORM_EPISODES = 100
"""As many scenarios as the paper's."""


@dataclass(frozen=True)
class Plan:
    """What is to be reproduced."""

    experiments: tuple[Experiment, ...]
    seeds: int
    episodes: int
    out: Path
    quick: bool
    command: str
    platforms: tuple[str, ...] = ()
    """Other simulators to fly the first seed's policies in."""


class Done(NamedTuple):
    """What a job came to."""

    train: dict[str, Any]
    judged: tuple[Judged, ...]


Report = Callable[[str, Progress], None]
Messages = Any
"""A queue of `multiprocessing.Manager` (its proxy is no `Queue`): names with their progress."""


def plan_families(
    families: Sequence[str],
    seeds: int,
    episodes: int,
    out: Path,
    quick: bool,
    command: str,
    platforms: Sequence[str] = (),
) -> Plan:
    """The experiments of some families. Raises InputError for an unknown one or a platform."""
    for each in platforms:
        check_platform(each)
    names: list[str] = []
    for family in families:
        if family != "all" and family not in FAMILIES:
            raise unknown_name("family", family, [*FAMILIES, "all"])
        chosen = list(FAMILIES) if family == "all" else [family]
        names += [name for key in chosen for name in FAMILIES[key] if name not in names]
    experiments = tuple(load_experiment(name) for name in names)
    if quick:
        experiments = tuple(_quick(experiment) for experiment in experiments)
    elsewhere = tuple(dict.fromkeys(name for name in platforms if name != OWN))
    return Plan(experiments, seeds, episodes, out, quick, command, elsewhere)


def run_plan(plan: Plan, report: Report) -> dict[str, Any]:
    """Run all jobs and write `results.json`; returns its contents (see docs/formats.md)."""
    begun = time.monotonic()
    make_folder(plan.out)
    done = _run_jobs(plan, report)
    by_seed: dict[tuple[str, bool], list[Judged]] = {}
    for job in done:
        for judged in job.judged:
            key = (judged.row["experiment"], judged.row["stacking"])
            by_seed.setdefault(key, []).append(judged)
    lateral = [each for each in plan.experiments if each.task.name == "lateral"]
    if lateral:
        conditions = Conditions(episodes=plan.episodes)
        nobody = judge_nobody(lateral[0], conditions, plan.out / "evaluation")
        by_seed[nobody.row["experiment"], False] = [nobody]
    results = {
        "rows": [_aggregate(group) for group in by_seed.values()],
        "rows_by_seed": [judged.row for group in by_seed.values() for judged in group],
        "train": [job.train for job in done],
        "wall_s": time.monotonic() - begun,
        "machine": machine(),
        "version": skystack.__version__,
        "command": plan.command,
        "quick": plan.quick,
        "platforms": [],
    }
    if lateral:
        write_aside(plan.out / "bound.json", fewest_clearances())
    _write_results(plan, results)
    return results


def run_platforms(plan: Plan, results: dict[str, Any], count: Count) -> list[str]:
    """Fly the first seed's policies in the plan's other simulators and add that to the results.

    Returns what was not finished, and why.
    """
    begun, trained_s = time.monotonic(), results["wall_s"]
    episodes = min(plan.episodes, PLATFORM_EPISODES)
    rows: list[Row] = []
    failed: list[str] = []
    for experiment in plan.experiments:
        policy = load_policy(plan.out / "train" / f"{experiment.name}-s0")
        found = judge_everywhere(policy, plan.platforms, episodes, plan.out / "evaluation", count)
        rows += found.rows
        failed += found.failed
        results["platforms"] = rows
        results["wall_s"] = trained_s + time.monotonic() - begun
        _write_results(plan, results)
    return failed


def _write_results(plan: Plan, results: dict[str, Any]) -> None:
    write_aside(plan.out / "results.json", (json.dumps(results, indent=1) + "\n").encode())


def fewest_clearances() -> bytes:
    """What `benchmarks/fewest_clearances.py` found for the evaluation scenarios, as JSON."""
    return files("skystack").joinpath("evaluation", "fewest_clearances.json").read_bytes()


def machine() -> str:
    """What the figures were measured on."""
    python = platform.python_version()
    return f"{platform.machine()}, {len(cores())} cores, {platform.system()}, Python {python}"


def _quick(experiment: Experiment) -> Experiment:
    """The same experiment with fewer steps, its first phase shortened alike."""
    whole, before = experiment.ppo.total_steps, experiment.pretraining
    steps = min(whole, QUICK_STEPS)
    if before is not None:
        shorter = max(before.steps * steps // whole, 1)
        before = msgspec.structs.replace(before, steps=shorter)
    ppo = msgspec.structs.replace(experiment.ppo, total_steps=steps)
    return msgspec.structs.replace(experiment, ppo=ppo, pretraining=before)


def _aggregate(group: Sequence[Judged]) -> Row:
    tables: list[pa.Table] = [judged.episodes for judged in group]
    return aggregate([judged.row for judged in group], tables)


def _run_jobs(plan: Plan, report: Report) -> list[Done]:
    """All (experiment, seed) pairs, in order of the plan; their progress goes to `report`."""
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
            futures = [
                pool.submit(_run_job, experiment, seed, plan.episodes, plan.out, messages)
                for experiment, seed in jobs
            ]
            return [future.result() for future in futures]
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


def _run_job(
    experiment: Experiment,
    seed: int,
    episodes: int,
    out: Path,
    messages: Messages,
) -> Done:
    """Train one policy and judge it, plain and stacked."""
    name = f"{experiment.name}-s{seed}"

    def send(progress: Progress) -> None:
        messages.put((name, progress))

    trained = train_experiment(experiment, seed, out / "train" / name, on_update=send)
    judged = tuple(
        judge(trained.policy, Conditions(episodes=episodes, stacking=stacking), out / "evaluation")
        for stacking in (False, True)
    )
    return Done(trained.summary, judged)
