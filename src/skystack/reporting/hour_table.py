"""The table of an evaluation on hours of arriving traffic."""

from collections.abc import Mapping, Sequence
from typing import Any

from skystack.evaluation.traffic_conditions import is_named
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING, percent


def hour_table(row: Mapping[str, Any]) -> Table:
    """One line per measure, for a row of `skystack.evaluation.hour_scores.summary`."""

    def number(name: str, digits: int = 1) -> str:
        return decimals(row[name], digits)

    lines = (
        ("flights (that have left)", f"{row['flights']:,} ({row['flights_gone']:,})"),
        ("hours", hours_in_words(row["hours"])),
        (
            "losses of separation (at birth)",
            losses(row["losses_of_separation"], row["losses_at_birth"]),
        ),
        ("close pairs, below 7 NM", f"{row['close_pairs']:,}"),
        ("fail-safe cycles", percent(row["fail_safe_rate"])),
        ("correct exits", percent(row["correct_exit_rate"])),
        ("excursions", percent(row["excursion_rate"])),
        ("exit offset, NM (median)", number("exit_offset_nm_median")),
        ("transmissions per flight", number("transmissions_per_flight", 2)),
        ("transmissions in the worst minute", f"{row['transmissions_worst_minute']}"),
        ("extra distance", percent(row["extra_miles_rate"])),
        ("level-offs per flight", number("level_offs_per_flight", 2)),
        ("delay, s", number("delay_s_mean")),
        ("lax score, s (mean)", number("lax_s_mean", 0)),
        ("strict score, s (mean)", number("strict_s_mean", 0)),
        ("decision, ms (median)", number("decision_ms_median")),
    )
    return Table(("measure", "value"), lines)


def decimals(value: float | None, digits: int) -> str:
    """A number with this many digits after the point."""
    return NOTHING if value is None else f"{value:,.{digits}f}"


def hours_in_words(hours: float) -> str:
    """Hours of traffic as `20`, or `0.167` for ten minutes."""
    return f"{round(hours, 3):g}"


def failed_in_words(count: int) -> str:
    """` (+ 2 failed)` after the number of finished hours or seeds; empty if none failed."""
    return f" (+ {count} failed)" if count else ""


def ranges(numbers: Sequence[int]) -> list[str]:
    """Increasing numbers as words, with runs of three and more as ranges: 1, 2, 5 to 9."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    words: list[str] = []
    for run in runs:
        words += [f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run)
    return words


def losses(count: int, at_birth: int) -> str:
    """Losses of separation, and in brackets those at birth."""
    return f"{count:,} ({at_birth:,})"


def traffic_in_words(traffic: str, named: str = "{}") -> str:
    """`60 flights/h`; or, for traffic that has a name, the name in the format `named`."""
    return named.format(traffic) if is_named(traffic) else f"{traffic} flights/h"
