"""The claims of the paper, one by one, judged by what a run measured.

Each claim is a test on figures of the run, first on the rows that keep every value that the paper
states, then on the rows that change some (`-tuned`). What a claim asks for is in its own function.
"""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
from scipy.stats import ttest_ind_from_stats

from skystack.evaluation.paper import PAPER, SCENARIOS
from skystack.evaluation.statistics import Estimate
from skystack.evaluation.stored import read_table
from skystack.reporting.learning_curves import running_mean
from skystack.reporting.results import Row, Run, Update
from skystack.reporting.tables import Table, interval, percent_interval

REPRODUCED, CHANGED, MISSED = "reproduced", "reproduced with a change", "not reproduced"
CONVERGED = 0.8
"""Success in training at which a policy counts as having learned."""
EQUAL = 0.01
"""Rates that differ by no more are called equal."""
CLIMB_FL = 150
"""The paper's example: fifteen instructions of ten levels."""


class Found(NamedTuple):
    """What one row, or two, say of a claim."""

    holds: bool
    figures: str


class Claim(NamedTuple):
    """A claim and its verdict."""

    family: str
    words: str
    paper: str
    """Its figures."""
    asked: str
    """What counts as reproduced."""
    found: str
    verdict: str


def judge_claims(run: Run) -> list[Claim]:
    """All claims that the run has figures for; none if it has no statistics."""
    if not all(row.statistics for row in run.results.rows):
        return []
    judges = (_lateral_counts, _damping, _stacking, _large, _learning, _vertical, _avoidance)
    return [claim for judge in judges for claim in judge(run)]


def claims_table(claims: Sequence[Claim]) -> Table:
    """One line a claim."""
    header = ("claim", "paper", "asked for", "here", "verdict")
    rows = [(each.words, each.paper, each.asked, each.found, each.verdict) for each in claims]
    return Table(header, tuple(rows))


def _lateral_counts(run: Run) -> Iterator[Claim]:
    yield from _count(run, "lateral", "undamped policies act almost every step", "lateral-undamped")
    yield from _count(run, "lateral", "instructions of the damped policy", "lateral")
    yield from _count(run, "lateral", "clearances, damped and stacked", "lateral", True)
    yield from _count(run, "lateral", "instructions with 37 actions", "lateral-large")


def _count(
    run: Run, family: str, words: str, experiment: str, stacking: bool = False
) -> Iterator[Claim]:
    """The mean lies within the paper's standard deviation of the paper's mean."""
    mean, spread = PAPER[experiment, stacking]
    found = [
        Found(abs(row.clearances_mean - mean) <= spread, f"{_named(row)} {_shown(row)}")
        for row in _variants(run, experiment, stacking)
        if row.clearances_mean is not None
    ]
    asked = "mean within the paper's standard deviation"
    yield from _claim(family, words, f"{mean} ± {spread}", asked, found)


def _damping(run: Run) -> Iterator[Claim]:
    undamped = run.results.row("lateral-undamped", False)
    if undamped is None:
        return
    cuts = [
        (row, 1.0 - _value(row, "instructions") / _value(undamped, "instructions"))
        for row in _variants(run, "lateral", False)
    ]
    found = [Found(0.82 <= cut <= 0.92, f"{_named(row)} {_rate(cut)}") for row, cut in cuts]
    words = "damping cuts instructions by about 87 %"
    yield from _claim("lateral", words, "113.0 to 14.5", "82 to 92 %", found)


def _stacking(run: Run) -> Iterator[Claim]:
    found = []
    for plain, stacked in _plain_and_stacked(run, "lateral"):
        cut = 1.0 - _value(stacked, "clearances") / _value(plain, "clearances")
        gained = _value(stacked, "success") - _value(plain, "success")
        figures = f"{_named(stacked)} {_rate(cut)}, success {100.0 * gained:+.1f} points"
        found.append(Found(cut >= 0.4 and gained >= -EQUAL, figures))
    words = "stacking about halves them again at equal success"
    yield from _claim("lateral", words, "14.5 to 7.2", "by 40 % or more, no less success", found)
    found = []
    for plain, stacked in _plain_and_stacked(run, "lateral-undamped"):
        cut = 1.0 - _value(stacked, "clearances") / _value(plain, "clearances")
        figures = f"{_shown(plain)} to {_shown(stacked)}: {_rate(cut)}"
        found.append(Found(cut < 0.2, figures))
    words = "undamped behaviour cannot be stacked"
    yield from _claim("lateral", words, NO_FIGURE, "stacking takes less than 20 %", found)


def _large(run: Run) -> Iterator[Claim]:
    large = run.results.row("lateral-large", False)
    if large is None:
        return
    found = []
    for row in _variants(run, "lateral", True):
        fewer = _value(row, "clearances") <= _value(large, "clearances")
        better = _value(row, "success") >= _value(large, "success") - EQUAL
        rates = f"success {_value(row, 'success'):.3f} against {_value(large, 'success'):.3f}"
        counts = f"{_named(row)} {_shown(row)} against {_shown(large)}"
        found.append(Found(fewer and better, f"{counts}, {rates}"))
    words = "five stacked actions do as well as 37"
    asked = "no more clearances, no less success"
    yield from _claim("lateral", words, "7.2 against 6.3", asked, found)
    yield from _significance(run)


def _significance(run: Run) -> Iterator[Claim]:
    """By the paper's own figures, and by the interval of our difference."""
    (stacked, its_spread), (large, spread) = PAPER["lateral", True], PAPER["lateral-large", False]
    p = ttest_ind_from_stats(
        stacked, its_spread, SCENARIOS, large, spread, SCENARIOS, equal_var=False
    ).pvalue
    found = []
    for row in _variants(run, "lateral", True):
        gap = _difference(run, row, "lateral-large")
        if gap is not None:
            holds = gap.low <= 0.0 <= gap.high
            found.append(Found(holds, f"{_named(row)} {interval(gap)}"))
    yield from _claim(
        "lateral",
        "6.3 against 7.2 is no significant difference",
        f"p = {p:.3f} (Welch's test on its figures)",
        "the interval of the difference holds 0",
        found,
    )


def _learning(run: Run) -> Iterator[Claim]:
    small, large = _curves(run, "lateral"), _curves(run, "lateral-large")
    if not small or not large:
        return
    steps = [median(_converged(updates) for updates in seeds) for seeds in (small, large)]
    yield from _claim(
        "lateral",
        "the small action space converges faster",
        "sooner and more reliably",
        f"{_rate(CONVERGED)} success after fewer steps, median of seeds",
        [Found(steps[0] < steps[1], " against ".join(map(_million, steps)))],
    )
    ends = [_end(updates) for updates in large]
    exits, bounds, few = (float(np.mean([end[k] for end in ends])) for k in range(3))
    figures = f"at the end: exit {_rate(exits)}, bounds {_rate(bounds)}, count {_rate(few)}"
    yield from _claim(
        "lateral",
        "the count criterion is what lowers the large policy's success",
        NO_FIGURE,
        "the count is met less often than exit and bounds",
        [Found(few < min(exits, bounds) - EQUAL, figures)],
    )


def _vertical(run: Run) -> Iterator[Claim]:
    plain, stacked = (run.results.row("vertical", way) for way in (False, True))
    if plain is None or stacked is None:
        return
    before, after = _climbs(run, plain), _climbs(run, stacked)
    if not len(before):
        return
    figures = f"{len(before)} climbs and descents: {before.mean():.1f} to {after.mean():.2f}"
    holds = bool(np.all(after == 1))
    words = "an instruction of fifteen steps becomes one"
    yield from _claim(
        "vertical", words, "15 to 1", "one clearance in every case", [Found(holds, figures)]
    )


def _avoidance(run: Run) -> Iterator[Claim]:
    yield from _count(run, "avoidance", "clearances, avoidance and stacked", "avoidance", True)
    yield from _count(run, "avoidance", "instructions, avoidance, 37 actions", "avoidance-large")
    rows = _variants(run, "avoidance", True)
    lost = [(row, row.statistics["loss_of_separation"].mean) for row in rows]
    found = [
        Found(rate.value <= 0.01, f"{_named(row)} {percent_interval(rate)}") for row, rate in lost
    ]
    words = "separation is lost in 1 scenario of 100"
    yield from _claim("avoidance", words, "1 %", "1 % or less", found)
    large = run.results.row("avoidance-large", False)
    if large is None:
        return
    theirs = large.statistics["loss_of_separation"].mean
    found = [
        Found(
            rate.value < theirs.value,
            f"{_named(row)} {percent_interval(rate)} against {percent_interval(theirs)}",
        )
        for row, rate in lost
    ]
    words = "stacked, separation is lost less often than with 37 actions"
    yield from _claim("avoidance", words, "1 against 9 of 100", "a lower mean", found)
    found = [
        Found(
            _value(row, "clearances") < _value(large, "clearances"),
            f"{_named(row)} {_shown(row)} against {_shown(large)}",
        )
        for row in rows
    ]
    words = "stacked, clearances are fewer than with 37 actions"
    yield from _claim("avoidance", words, "81.2 against 126.3", "a lower mean", found)


NO_FIGURE = "\N{EN DASH}"


def _claim(
    family: str, words: str, paper: str, asked: str, found: Sequence[Found]
) -> Iterator[Claim]:
    """The first finding is at the paper's values, the others with some changed."""
    if found:
        holding = [each.holds for each in found]
        verdict = REPRODUCED if holding[0] else CHANGED if any(holding) else MISSED
        figures = "; ".join(each.figures for each in found)
        yield Claim(family, words, paper, asked, figures, verdict)


def _variants(run: Run, experiment: str, stacking: bool) -> list[Row]:
    """A row at the paper's values, then the one with some changed, as far as they are there."""
    names = (experiment, f"{experiment}-tuned")
    rows = [run.results.row(name, stacking) for name in names]
    return [row for row in rows if row is not None]


def _plain_and_stacked(run: Run, experiment: str) -> list[tuple[Row, Row]]:
    plain = _variants(run, experiment, False)
    both = [(row, run.results.row(row.experiment, True)) for row in plain]
    return [(row, stacked) for row, stacked in both if stacked is not None]


def _value(row: Row, measure: str) -> float:
    return row.statistics[measure].mean.value


def _named(row: Row) -> str:
    """Whether it keeps the paper's values."""
    return "tuned" if row.experiment.endswith("-tuned") else "as stated"


def _shown(row: Row) -> str:
    return interval(row.statistics["clearances"].mean)


def _difference(run: Run, row: Row, other: str) -> Estimate | None:
    """Of clearances, stacked against the other's unstacked ones."""
    for each in run.results.comparisons:
        if (each.first.experiment, each.second.experiment) == (row.experiment, other):
            return each.measures["clearances"].difference
    return None


def _curves(run: Run, experiment: str) -> list[list[Update]]:
    return [
        run.updates(training) for training in run.results.train if training.experiment == experiment
    ]


def _converged(updates: Sequence[Update]) -> float:
    """Steps until the running success is there; infinite if it never is."""
    success = _smooth(updates, "success")
    there = np.flatnonzero(success >= CONVERGED)
    return float(updates[there[0]].steps) if len(there) else np.inf


def _smooth(updates: Sequence[Update], field: str) -> np.ndarray:
    values = np.array([getattr(update, field) for update in updates], dtype=float)
    return running_mean(values, np.array([update.episodes for update in updates]))


def _end(updates: Sequence[Update]) -> tuple[float, float, float]:
    """Exit, bounds and count at the end of a training."""
    exits, strays, few = (
        float(_smooth(updates, field)[-1])
        for field in ("correct_exit", "excursion", "few_instructions")
    )
    return exits, 1.0 - strays, few


def _rate(value: float) -> str:
    return f"{100.0 * value:.0f} %"


def _million(steps: float) -> str:
    return f"{steps / 1e6:.2f} million" if np.isfinite(steps) else "never"


def _climbs(run: Run, row: Row) -> np.ndarray:
    """Clearances in the first seed's scenarios whose levels are as far apart as the paper's."""
    folder = run.evaluation(row)
    aircraft = read_table(folder / "aircraft.parquet", ("scenario", "entry_fl", "exit_fl"))
    entry, leave = (aircraft[name].to_numpy() for name in ("entry_fl", "exit_fl"))
    chosen = aircraft["scenario"].to_numpy()[np.abs(leave - entry) == CLIMB_FL]
    episodes = read_table(folder / "episodes.parquet", ("scenario", "clearances"))
    wanted = np.isin(episodes["scenario"].to_numpy(), chosen)
    clearances: np.ndarray = episodes["clearances"].to_numpy()[wanted]
    return clearances
