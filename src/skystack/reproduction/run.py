"""A whole reproduction: all jobs, the rows over all seeds with their statistics, `results.json`."""

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
from skystack.reproduction.jobs import EvaluatedRow, JobResult, OnProgress, no_op_once
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
"""Rows, (experiment, stacked), that the paper or we compare."""


Engine = Callable[[Plan, OnProgress], list[JobResult]]
"""Runs all jobs of a plan, somewhere, and leaves their files in its folder."""


def run_plan(plan: Plan, report: OnProgress, engine: Engine = run_in_processes) -> dict[str, Any]:
    """Run all jobs and write `results.json`; returns its contents (see docs/formats.md)."""
    begun = time.monotonic()
    make_folder(plan.out)
    done = engine(plan, report)
    by_row: dict[tuple[str, bool], list[EvaluatedRow]] = {}
    for job in done:
        for flown in job.flown:
            by_row.setdefault((flown.row["experiment"], flown.row["stacking"]), []).append(flown)
    kept = [name for job in done for name in job.kept]
    lateral = [each for each in plan.experiments if each.task.name == "lateral"]
    if lateral:
        nobody, before = no_op_once(plan, lateral[0])
        by_row[nobody.row["experiment"], False] = [nobody]
        kept += ["evaluation of no instructions"] * before
        atomic_write(plan.out / "bound.json", fewest_clearances())
    results = {
        "rows": [_row(group) for group in by_row.values()],
        "rows_by_seed": [flown.row for group in by_row.values() for flown in group],
        "comparisons": _comparisons(by_row),
        "train": [job.train for job in done],
        "wall_s": time.monotonic() - begun,
        "kept": kept,
        "machine": machine(),
        "version": skystack.__version__,
        "command": plan.command,
        "quick": plan.quick,
        "platforms": [],
    }
    _write_results(plan, results)
    return results


def run_platforms(plan: Plan, results: dict[str, Any], count: ScenarioCounter) -> list[str]:
    """Fly the first seed's policies in the plan's other simulators and add that to the results.

    Returns what was not finished, and why.
    """
    begun, trained_s = time.monotonic(), results["wall_s"]
    rows: list[RowValues] = []
    failed: list[str] = []
    for experiment in plan.experiments:
        policy = load_policy(plan.training(f"{experiment.name}-s0"))
        record = make_folder(plan.evaluation) / f"{experiment.name}-s0-platforms.json"
        found = _everywhere_once(plan, policy, record, count)
        rows += found["rows"]
        failed += found["failed"]
        results["platforms"] = rows
        results["wall_s"] = trained_s + time.monotonic() - begun
        _write_results(plan, results)
    return failed


def _everywhere_once(
    plan: Plan, policy: Policy, record: Path, count: ScenarioCounter
) -> dict[str, Any]:
    """One policy in all simulators, unless it was before; what failed is tried again."""
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
    """What `studies/fewest_clearances.py` found for the evaluation scenarios, as JSON."""
    return files("skystack").joinpath("evaluation", "fewest_clearances.json").read_bytes()


def machine() -> str:
    """What the figures were measured on."""
    python, count = platform.python_version(), len(cores())
    many = f"{count} core" + "s" * (count > 1)
    return f"{platform.machine()}, {many}, {platform.system()}, Python {python}"


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
