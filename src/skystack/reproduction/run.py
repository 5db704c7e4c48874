"""Run a whole reproduction: all jobs, rows over all seeds with statistics, `results.json`."""

import json
import platform
import time
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import skystack
from skystack.compilation.cores import cores
from skystack.evaluation.cross_platform import ScenarioCounter, evaluate_on_platforms
from skystack.evaluation.statistics import MEASURES, comparison, row_statistics
from skystack.evaluation.summary import RowValues, aggregate
from skystack.io.files import atomic_write, make_folder
from skystack.learning.policy import Policy, load_policy
from skystack.reproduction.jobs import EvaluatedRow, JobResult, OnProgress
from skystack.reproduction.pieces import once
from skystack.reproduction.plan import PLATFORM_EPISODES, Plan
from skystack.reproduction.processes import run_in_processes

COMPARED = (
    (("lateral", False), ("lateral-undamped", False)),
    (("lateral", True), ("lateral", False)),
    (("lateral", True), ("lateral-large", False)),
    (("lateral-tuned", True), ("lateral-tuned", False)),
    (("lateral-tuned", True), ("lateral-large", False)),
    (("lateral-best", True), ("lateral-tuned", True)),
    (("vertical", True), ("vertical", False)),
    (("avoidance", True), ("avoidance", False)),
    (("avoidance", True), ("avoidance-large", False)),
    (("avoidance-tuned", True), ("avoidance", True)),
    (("avoidance-best", True), ("avoidance-tuned", True)),
)
"""Pairs of rows (experiment, stacked) that are compared, by the paper or here."""


Engine = Callable[[Plan, OnProgress], list[JobResult]]
"""Runs all jobs of a plan and puts their files into its folder."""


def run_plan(plan: Plan, report: OnProgress, engine: Engine = run_in_processes) -> dict[str, Any]:
    """Run all jobs and write `results.json`; returns its contents (see docs/formats.md)."""
    started_s = time.monotonic()
    make_folder(plan.out)
    jobs = engine(plan, report)
    by_row: dict[tuple[str, bool], list[EvaluatedRow]] = {}
    sampled: dict[tuple[str, bool], list[EvaluatedRow]] = {}
    for job in jobs:
        for flown in job.flown:
            rows = by_row if flown.row["greedy"] else sampled
            rows.setdefault((flown.row["experiment"], flown.row["stacking"]), []).append(flown)
    cached_names = [name for job in jobs for name in job.kept]
    if any(experiment.task.name == "lateral" for experiment in plan.experiments):
        atomic_write(plan.out / "bound.json", fewest_clearances())
    results = {
        "rows": [_row(group) for group in by_row.values()],
        "rows_by_seed": [flown.row for group in by_row.values() for flown in group],
        "sampled": [_row(group) for group in sampled.values()],
        "comparisons": _comparisons(by_row),
        "train": [job.train for job in jobs if job.train is not None],
        "wall_s": time.monotonic() - started_s,
        "kept": cached_names,
        "machine": machine(),
        "version": skystack.__version__,
        "command": plan.command,
        "quick": plan.quick,
        "platforms": [],
    }
    _write_results(plan, results)
    return results


def run_platforms(plan: Plan, results: dict[str, Any], count: ScenarioCounter) -> list[str]:
    """Fly the first seed's policies in the plan's other simulators; add their rows to the results.

    Returns the scenarios that were not finished, each with the reason.
    """
    started_s, training_s = time.monotonic(), results["wall_s"]
    rows: list[RowValues] = []
    failed: list[str] = []
    for experiment in plan.experiments:
        policy = load_policy(plan.training(f"{experiment.name}-s0"))
        record = make_folder(plan.evaluation) / f"{experiment.name}-s0-platforms.json"
        found = _on_platforms_once(plan, policy, record, count)
        rows += found["rows"]
        failed += found["failed"]
        results["platforms"] = rows
        results["wall_s"] = training_s + time.monotonic() - started_s
        _write_results(plan, results)
    return failed


def _on_platforms_once(
    plan: Plan, policy: Policy, record: Path, count: ScenarioCounter
) -> dict[str, Any]:
    """The evaluation of one policy in all simulators; cached only if no scenario failed."""
    episodes = min(plan.episodes, PLATFORM_EPISODES)

    def fly() -> dict[str, Any]:
        found = evaluate_on_platforms(policy, plan.platforms, episodes, plan.evaluation, count)
        return {"rows": found.rows, "failed": found.failed}

    key = {
        "policy": policy.description.sha256,
        "platforms": list(plan.platforms),
        "episodes": episodes,
        "version": skystack.__version__,
    }
    found, _ = once(record, key, fly)
    if found["failed"]:
        record.unlink()
    result: dict[str, Any] = found
    return result


def fewest_clearances() -> bytes:
    """The results of `studies/fewest_clearances.py` for the evaluation scenarios, as JSON."""
    return files("skystack").joinpath("evaluation", "fewest_clearances.json").read_bytes()


def machine() -> str:
    """A description of this machine, for the figures measured on it."""
    python, count = platform.python_version(), len(cores())
    core_count = f"{count} core" + "s" * (count > 1)
    return f"{platform.machine()}, {core_count}, {platform.system()}, Python {python}"


def _row(group: Sequence[EvaluatedRow]) -> RowValues:
    episodes = [flown.episodes for flown in group]
    row = aggregate([flown.row for flown in group], episodes)
    return row | {"statistics": row_statistics(episodes)}


def _comparisons(by_row: dict[tuple[str, bool], list[EvaluatedRow]]) -> list[dict[str, Any]]:
    return [
        {
            "first": dict(zip(("experiment", "stacking"), first, strict=True)),
            "second": dict(zip(("experiment", "stacking"), second, strict=True)),
            "measures": {
                measure: comparison(
                    [flown.episodes for flown in by_row[first]],
                    [flown.episodes for flown in by_row[second]],
                    measure,
                )
                for measure in MEASURES
            },
        }
        for first, second in COMPARED
        if first in by_row and second in by_row
    ]


def _write_results(plan: Plan, results: dict[str, Any]) -> None:
    atomic_write(plan.out / "results.json", (json.dumps(results, indent=1) + "\n").encode())
