"""The table of Flight School results: scores with intervals, survival, and what ended the hours."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skystack.errors import printable
from skystack.evaluation.hour_row import HourRow
from skystack.reporting.hour_table import (
    decimals,
    failed_in_words,
    losses,
    ranges,
    traffic_in_words,
)
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING, percent
from skystack.simulator.simulator import CYCLE_S

SHOWN = 6
"""The number of times at which survival is shown."""


def flight_school_table(row: Mapping[str, Any], strict: bool = False) -> Table:
    """One line per measure, for a row of `skystack.evaluation.flight_school`.

    Survival, and what ended the hours, are those of the lax score or, with `strict`, of the strict
    one.
    """
    score = "strict" if strict else "lax"
    by_seed, length_s = row[f"{score}_s_by_seed"], float(CYCLE_S * row["cycles"])
    # An hour that fails in its last cycle has the score of a whole hour.
    whole = row["seeds"] - sum(row[f"{score}_ended_by"].values())
    at_s = [length_s * (number + 1) / SHOWN for number in range(SHOWN)]
    lines = (
        ("controller", printable(row["agent"])),
        ("traffic", f"{printable(traffic_in_words(row['traffic']))}, in {row['platform']}"),
        (
            f"hours of traffic, {length_s:,.0f} s each",
            f"{row['seeds']}{failed_in_words(len(row['failed_seeds']))}",
        ),
        ("seeds", ", ".join(ranges(row["seed_numbers"]))),
        ("lax score, s", _score(row, "lax")),
        ("  without losses at birth", f"{row['lax_without_births_s_mean']:,.0f}"),
        ("strict score, s", _score(row, "strict")),
        (f"hours without a failure ({score})", f"{whole} of {row['seeds']}"),
        (f"hours ended by ({score})", _causes(row[f"{score}_ended_by"])),
        (f"survival (%) at {_times(at_s)}", survival_text(by_seed, at_s, whole)),
        (
            "correct exits, of flights that left",
            f"{row['deliveries']:,} of {row['flights_gone']:,}",
        ),
        (
            "losses of separation (at birth)",
            losses(row["losses_of_separation"], row["losses_at_birth"]),
        ),
        ("losses per flight hour", decimals(row["losses_per_flight_hour"], 4)),
        ("excursions", percent(row["excursion_rate"])),
        ("transmissions per flight", decimals(row["transmissions_per_flight"], 2)),
        ("transmissions per minute", decimals(row["transmissions_per_minute"], 1)),
        (
            "decision, ms (median, 99th pct.)",
            f"{row['decision_ms_median']:.1f}, {row['decision_ms_p99']:.1f}",
        ),
    )
    return Table(("measure", "value"), lines)


def comparison(rows: Sequence[HourRow]) -> Table:
    """One line per controller, the best lax score first."""
    header = (
        "controller", "seeds", "lax score, s", "without losses at birth", "strict score, s",
        "ended by (lax)", "correct exits", "losses of separation (at birth)",
        "losses per flight hour", "excursions",
        "transmissions per flight", "decision, ms",
    )  # fmt: skip
    best_first = sorted(rows, key=lambda row: -row.lax_s_mean)
    return Table(header, tuple(map(_compared, best_first)))


def _compared(row: HourRow) -> tuple[str, ...]:
    return (
        row.agent,
        f"{len(row.lax_s_by_hour)}{failed_in_words(len(row.failed_seeds))}",
        _with_interval(row.lax_s_mean, row.lax_s_interval),
        f"{row.lax_without_births_s_mean:,.0f}",
        _with_interval(row.strict_s_mean, row.strict_s_interval),
        _causes(row.lax_ended_by),
        percent(row.correct_exit_rate),
        losses(row.losses_of_separation, row.losses_at_birth),
        decimals(row.losses_per_flight_hour, 4),
        percent(row.excursion_rate),
        decimals(row.transmissions_per_flight, 2),
        f"{row.decision_ms_median:.1f}",
    )


def _with_interval(mean: float, between: tuple[float, float] | None) -> str:
    if between is None:
        return f"{mean:,.0f}"
    return f"{mean:,.0f} ± {(between[1] - between[0]) / 2.0:,.0f}"


def survival_text(by_seed: Sequence[float], at_s: Sequence[float], whole: int) -> str:
    """The share of hours that had not failed before each time, in percent.

    The last time is the end of the hours, `whole` of which have no failure.
    """
    alive = [int(np.sum(np.asarray(by_seed) >= time_s)) for time_s in at_s[:-1]]
    return " ".join(f"{100.0 * each / len(by_seed):.0f}" for each in [*alive, whole])


def _score(row: Mapping[str, Any], score: str) -> str:
    """The mean, with its interval and range if there are several seeds."""
    mean, between = row[f"{score}_s_mean"], row[f"{score}_s_interval"]
    if between is None:
        return f"{mean:,.0f}"
    values = row[f"{score}_s_by_seed"]
    return f"{_with_interval(mean, between)} ({min(values):,.0f} to {max(values):,.0f})"


def _causes(ended_by: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in ended_by.items()) or NOTHING


def _times(at_s: Sequence[float]) -> str:
    """Times in minutes if they are whole ones, otherwise in seconds."""
    if all(time_s % 60.0 == 0.0 for time_s in at_s):
        return " ".join(f"{time_s / 60.0:g}" for time_s in at_s) + " min"
    return " ".join(f"{time_s:.0f}" for time_s in at_s) + " s"
