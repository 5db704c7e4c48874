"""Rows of the comparison: the tables of an evaluation reduced to the numbers that are reported."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from skystack.evaluation.paper import paper_row

RowValues = dict[str, Any]


def summarise(
    experiment: str,
    seed: int,
    platform: str,
    stacking: bool,
    greedy: bool,
    wall_s: float,
    episodes: pa.Table,
) -> RowValues:
    """The row of one policy on its scenarios, which took `wall_s` to fly."""
    row = _row(experiment, 1, platform, stacking, greedy, episodes)
    return {"seed": seed, **row, "wall_s": wall_s}


def aggregate(rows: Sequence[RowValues], episodes: Sequence[pa.Table]) -> RowValues:
    """One row for all training seeds: the statistics of their scenarios put together."""
    first = rows[0]
    row = _row(
        first["experiment"],
        len(rows),
        first["platform"],
        first["stacking"],
        first["greedy"],
        pa.concat_tables(episodes),
    )
    return row | {"wall_s": sum(each["wall_s"] for each in rows)}


def _row(
    experiment: str, seeds: int, platform: str, stacking: bool, greedy: bool, episodes: pa.Table
) -> RowValues:
    column = {name: episodes[name].to_numpy() for name in episodes.column_names}
    separation = column["min_separation_nm"]
    finite = separation[np.isfinite(separation)]
    return {
        "experiment": experiment,
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
        "paper": paper_row(experiment, stacking),
    }
