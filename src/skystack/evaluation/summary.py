"""Rows of the comparison: the reported numbers of an evaluation."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from skystack.io.names import check_name
from skystack.platforms.registry import OWN

RowValues = dict[str, Any]

_NO_OP, _SHIPPED = "do-nothing", "-shipped"


def no_op_name(task: str) -> str:
    """The experiment name in a task's row without a policy, which issues no instructions."""
    return f"{_NO_OP}-{task}"


def is_no_op(experiment: str) -> bool:
    """Whether an experiment name is that of a row without a policy; old files state no task."""
    return experiment == _NO_OP or experiment.startswith(f"{_NO_OP}-")


def shipped_name(experiment: str) -> str:
    """The experiment name in the row of a shipped policy, beside one that was trained here."""
    return experiment + _SHIPPED


def trained_name(experiment: str) -> str:
    """The experiment of a row, also of one with a shipped policy."""
    return experiment.removesuffix(_SHIPPED)


def evaluation_folder(
    out: Path,
    experiment: str,
    seed: int,
    stacking: bool,
    platform: str = OWN,
    greedy: bool = True,
) -> Path:
    """The folder for the tables of an evaluation. Raises InputError for an invalid name."""
    check_name("the name of the experiment", experiment)
    kind = "stacked" if stacking else "plain"
    sampled = "" if greedy else "-sampled"
    return out / f"{experiment}-s{seed}-{platform}-{kind}{sampled}"


def summarise(
    experiment: str,
    task: str,
    seed: int,
    platform: str,
    stacking: bool,
    greedy: bool,
    wall_s: float,
    episodes: pa.Table,
) -> RowValues:
    """The row of one policy, without the paper's numbers. `wall_s` is the time of its flights."""
    row = _row(experiment, task, 1, platform, stacking, greedy, episodes, None)
    return {"seed": seed, **row, "wall_s": wall_s}


def aggregate(rows: Sequence[RowValues], episodes: Sequence[pa.Table]) -> RowValues:
    """One row for all training seeds, computed over the scenarios of all of them."""
    first = rows[0]
    row = _row(
        first["experiment"],
        first.get("task"),  # absent in cached rows of older versions
        len(rows),
        first["platform"],
        first["stacking"],
        first["greedy"],
        pa.concat_tables(episodes),
        first["paper"],
    )
    return row | {"wall_s": sum(each["wall_s"] for each in rows)}


def _row(
    experiment: str,
    task: str | None,
    seeds: int,
    platform: str,
    stacking: bool,
    greedy: bool,
    episodes: pa.Table,
    paper: dict[str, float] | None,
) -> RowValues:
    column = {name: episodes[name].to_numpy() for name in episodes.column_names}
    others = {name: float(np.mean(column[name])) for name in column if name not in _REPORTED}
    separation = column["min_separation_nm"]
    finite = separation[np.isfinite(separation)]
    exits = column["exits"]
    offset_nm = np.nan_to_num(column["exit_offset_nm"].astype(np.float64))
    return {
        "experiment": experiment,
        "task": task,
        "seeds": seeds,
        "platform": platform,
        "stacking": stacking,
        "greedy": greedy,
        "episodes": episodes.num_rows,
        "clearances_mean": float(np.mean(column["clearances"])),
        "clearances_std": float(np.std(column["clearances"])),
        "instructions_mean": float(np.mean(column["instructions"])),
        "success_rate": float(np.mean(column["success"])),
        "correct_exit_rate": float(np.mean(column["correct_exit"])),
        "excursion_rate": float(np.mean(column["excursion"])),
        "few_clearances_rate": float(np.mean(column["few_clearances"])),
        "loss_of_separation_count": int(np.sum(column["loss_of_separation"])),
        "min_separation_nm_min": float(np.min(finite)) if finite.size else None,
        "min_separation_nm_mean": float(np.mean(finite)) if finite.size else None,
        "exit_offset_nm_mean": float(np.average(offset_nm, weights=exits)) if exits.any() else None,
        "paper": paper,
        **({"metrics": others} if others else {}),
    }


_REPORTED = {
    *("scenario", "clearances", "instructions", "return", "success", "correct_exit", "excursion"),
    *("few_clearances", "min_separation_nm", "loss_of_separation", "cycles"),
    *("exits", "exit_offset_nm"),
}
"""Columns with fields of their own; the means of the others are in `metrics`."""
