"""Tables of results, and the formats of their numbers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from skystack.evaluation.estimate import Estimate
from skystack.reporting.results import SIMULATORS, Bound, Number, Results, Row
from skystack.reporting.table import Table

NOTHING = "\N{EN DASH}"


def _every_row(row: Row) -> bool:
    return True


def comparison(
    rows: Sequence[Row], bound: Bound | None = None, is_trained: Callable[[Row], bool] = _every_row
) -> Table:
    """One line per row, with the paper's clearances; the fewest possible clearances come last.

    Clearances and instructions of policies that are not trained are not shown.
    """
    header = ("row", "paper", *_MEASURED, "seeds")
    lines = [
        (row.name, _paper(row), *_counts(row, is_trained), *_rates(row), str(row.seeds))
        for row in rows
    ]
    if bound is not None:
        blank = [NOTHING] * (len(header) - 3)
        lines.append(("fewest possible", NOTHING, f"{bound.clearances_mean:.1f}", *blank))
    return Table(header, tuple(lines))


def brief(
    rows: Sequence[Row], bound: Bound | None = None, is_trained: Callable[[Row], bool] = _every_row
) -> Table:
    """The main figures of the rows of one family, narrow enough for a terminal of 80 columns."""
    lines = [
        {
            "row": row.name.removeprefix(f"{row.family}, "),
            "paper": _paper(row),
            "clearances": _counts(row, is_trained)[0],
            "success": _success(row),
            "exit offset, NM": decimal(row.exit_offset_nm_mean),
            "loss rate": _loss_rate(row),
        }
        for row in rows
    ]
    header = ["row", "paper", "clearances", "success", "exit offset, NM", "loss rate"]
    if not any(row.paper for row in rows):
        header.remove("paper")
    if not any(row.family == "avoidance" for row in rows):
        header.remove("loss rate")
    if bound is not None:
        least = {"row": "fewest possible", "clearances": decimal(bound.clearances_mean)}
        lines.append(dict.fromkeys(header, NOTHING) | least)
    return Table(tuple(header), tuple(tuple(line[name] for name in header) for line in lines))


def one_row(values: Mapping[str, Any]) -> Table:
    """One line per measure, for a row as evaluation returns it."""
    row = msgspec.convert(values, Row)
    lost = row.loss_of_separation_count
    lines = [
        ("clearances per scenario", _clearances(row)),
        *([("clearances in the paper", _paper(row))] if row.paper else []),
        ("instructions per scenario", decimal(row.instructions_mean)),
        ("success", _success(row)),
        ("correct exit", percent(row.correct_exit_rate)),
        ("excursion", percent(row.excursion_rate)),
        ("few clearances", percent(row.few_clearances_rate)),
        ("exit offset, NM", decimal(row.exit_offset_nm_mean)),
        ("scenarios with a loss of separation", f"{lost} of {row.episodes}"),
    ]
    return Table(("measure", "value"), tuple(lines))


def sampled(results: Results) -> Table:
    """One line per row with sampled actions, beside the same policies' most probable actions."""
    header = (
        "row",
        "paper",
        "clearances",
        "clearances, sampled",
        "success",
        "success, sampled",
        "loss rate",
        "loss rate, sampled",
    )
    lines = []
    for row in results.sampled:
        pair = (results.row(row.experiment, row.stacking), row)
        cells = (
            NOTHING if each is None else cell(each)
            for cell in (_clearances, _success, _loss_rate)
            for each in pair
        )
        lines.append((row.name, _paper(row), *cells))
    return Table(header, tuple(lines))


def platforms(rows: Sequence[Row]) -> Table:
    """The same policies on the same scenarios in several simulators, one line per row."""
    header = (
        "row",
        "paper",
        "simulator",
        "clearances",
        "success",
        "correct exit",
        "losses of separation",
        "same clearances",
        "wall time",
    )
    lines = [
        (
            row.policy,
            _paper(row),
            SIMULATORS.get(row.platform, row.platform),
            _clearances(row),
            _success(row),
            percent(row.correct_exit_rate),
            f"{row.loss_of_separation_count} of {row.episodes}",
            percent(row.same_clearances_rate),
            NOTHING if row.wall_s is None else duration(row.wall_s),
        )
        for row in rows
    ]
    return Table(header, tuple(lines))


def estimates(rows: Sequence[Row]) -> Table:
    """Means over seeds with their 95 % intervals; with several seeds also interquartile means."""
    several = any(row.seeds > 1 for row in rows)
    lines = []
    for row in rows:
        if not row.statistics:
            continue
        clearances, success = row.statistics["clearances"], row.statistics["success"]
        lost = row.statistics["loss_of_separation"].mean
        cells = {
            "row": row.name,
            "clearances": interval(clearances.mean),
            "clearances, interquartile": interval(clearances.iqm),
            "success": percent_interval(success.mean),
            "success, interquartile": percent_interval(success.iqm),
            "losses of separation": percent_interval(lost),
        }
        lines.append(
            {name: cell for name, cell in cells.items() if several or "interquartile" not in name}
        )
    header = tuple(lines[0]) if lines else ()
    return Table(header, tuple(tuple(line.values()) for line in lines))


def comparisons(results: Results) -> Table:
    """One line per pair of rows: their difference, and the probability that the first is better.

    Better means that a seed of the first has fewer clearances, or more success, than a seed of the
    second. Ties count half. With a single seed of each there is no probability.
    """
    header = (
        "rows",
        "difference in clearances",
        "first has fewer",
        "difference in success, points",
        "first has more",
    )
    lines = []
    for each in results.comparisons:
        pair = [results.row(name.experiment, name.stacking) for name in (each.first, each.second)]
        first, second = ("?" if row is None else row.name for row in pair)
        clearances, success = each.measures["clearances"], each.measures["success"]
        fewer, less = clearances.probability_less, success.probability_less
        more = Estimate(*(1.0 - value for value in _ends_swapped(less)))
        several = any(row is not None and row.seeds > 1 for row in pair)
        lines.append(
            (
                f"{first} against {second}",
                interval(clearances.difference),
                percent_interval(fewer, 0) if several else NOTHING,
                interval(Estimate(*(100.0 * value for value in success.difference))),
                percent_interval(more, 0) if several else NOTHING,
            )
        )
    return Table(header, tuple(lines))


def _ends_swapped(estimate: Estimate) -> tuple[float, float, float]:
    """The value and the swapped interval ends, for a quantity that falls as this one rises."""
    return estimate.value, estimate.high, estimate.low


def by_seed(results: Results) -> Table:
    """One line per training run."""
    header = ("row", "seed", *_MEASURED)
    rows = [
        (
            row.name,
            NOTHING if row.seed is None else str(row.seed),
            *_counts(row, _every_row),
            *_rates(row),
        )
        for row in results.rows_by_seed
    ]
    return Table(header, tuple(rows))


def seeds_side_by_side(results: Results, rows: Sequence[Row]) -> Table:
    """One line per row: clearances and success for each seed."""
    numbers = sorted({each.seed for each in results.rows_by_seed if each.seed is not None})
    lines = []
    for row in rows:
        cells = {
            each.seed: f"{decimal(each.clearances_mean)}, {_success(each)}"
            for each in results.rows_by_seed
            if (each.experiment, each.stacking) == (row.experiment, row.stacking)
        }
        lines.append((row.name, *(cells.get(number, NOTHING) for number in numbers)))
    header = ("clearances, success", *(f"seed {number}" for number in numbers))
    return Table(header, tuple(lines))


def trainings(results: Results) -> Table:
    """The steps and the duration of each training run."""
    rows = [
        (
            training.experiment,
            str(training.seed),
            f"{training.steps:,}",
            duration(training.wall_s),
            f"{training.steps_per_s:,.0f}",
        )
        for training in results.train
    ]
    return Table(("experiment", "seed", "steps", "time", "steps per second"), tuple(rows))


def duration(seconds: float) -> str:
    """Format as `48 s`, `3 min 05 s` or `2 h 05 min`."""
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


_MEASURED = (
    "clearances",
    "instructions",
    "success",
    "correct exit",
    "excursion",
    "few clearances",
    "exit offset, NM",
    "losses of separation",
)


def _counts(row: Row, is_trained: Callable[[Row], bool]) -> tuple[str, ...]:
    if not row.is_no_op and not is_trained(row):
        return ("not trained", NOTHING)
    return _clearances(row), decimal(row.instructions_mean)


def _rates(row: Row) -> tuple[str, ...]:
    return (
        _success(row),
        percent(row.correct_exit_rate),
        percent(row.excursion_rate),
        percent(row.few_clearances_rate),
        decimal(row.exit_offset_nm_mean),
        f"{row.loss_of_separation_count} of {row.episodes}",
    )


def _clearances(row: Row) -> str:
    return mean_and_std(row.clearances_mean, row.clearances_std)


def _success(row: Row) -> str:
    return percent(row.success_rate)


def _loss_rate(row: Row) -> str:
    return percent(row.loss_of_separation_count / max(row.episodes, 1))


def _paper(row: Row) -> str:
    if row.paper is None:
        return NOTHING
    return mean_and_std(row.paper.clearances_mean, row.paper.clearances_std)


def mean_and_std(mean: Number, std: Number) -> str:
    """Format as `7.2 ± 3.5`."""
    return decimal(mean) if mean is None or std is None else f"{mean:.1f} ± {std:.1f}"


def interval(estimate: Estimate) -> str:
    """Format as `7.2 [6.9, 7.5]`; without an interval if all values are the same."""
    value, low, high = (f"{each:.1f}" for each in estimate)
    return value if low == value == high else f"{value} [{low}, {high}]"


def percent_interval(estimate: Estimate, places: int = 1) -> str:
    """Format as `98.3 % [97.5, 99.0]`; without an interval if all values are the same.

    A bootstrap of equal values has an interval without width, which would claim too much.
    """
    value, low, high = (f"{100.0 * each:.{places}f}" for each in estimate)
    return f"{value} %" if low == value == high else f"{value} % [{low}, {high}]"


def decimal(value: Number) -> str:
    """Format as `7.2`."""
    return NOTHING if value is None else f"{value:.1f}"


def percent(rate: Number) -> str:
    """Format as `98.3 %`."""
    return NOTHING if rate is None else f"{100.0 * rate:.1f} %"
