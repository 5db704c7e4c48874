"""The claims of the paper, each checked against the results of a run.

Only trained policies can support or refute a claim: those that succeed clearly more often than
doing nothing does (`Results.is_trained`). A policy that hardly acts would satisfy some of them.

A claim is tested first on the rows with the settings that the paper states, then on the rows that
change some of them (`-tuned`). Each function below contains the criteria of its claims.
"""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
from scipy.stats import ttest_ind_from_stats

from skystack.evaluation.estimate import Estimate
from skystack.evaluation.paper import PAPER, SCENARIOS
from skystack.evaluation.stored import read_table
from skystack.reporting.learning_curves import LEARNED, at_the_end, steps_until
from skystack.reporting.results import Row, RowName, Run, Update
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING, interval, percent_interval

REPRODUCED, CHANGED, MISSED = "reproduced", "reproduced with changed settings", "not reproduced"
UNDECIDED = "cannot be judged"
"""The verdict if the first finding is about an untrained policy and no other one holds."""
EQUAL = 0.01
"""Rates that differ by no more than this count as equal."""
ROUNDING = 1e-9
"""The tolerance for rounding errors: in binary, 0.99 - 0.98 exceeds 0.01."""
CLIMB_FL = 150
"""The paper's example: fifteen instructions of ten levels each."""


class Found(NamedTuple):
    """The finding on a claim for one row or for a pair of rows."""

    holds: bool
    figures: str
    judged: bool
    """Whether all policies involved are trained."""
    changed: bool
    """Whether a policy involved has other settings than the paper states."""


class Claim(NamedTuple):
    """A claim and its verdict."""

    family: str
    words: str
    paper: str
    """The paper's numbers."""
    asked: str
    """The criterion for `reproduced`."""
    found: str
    verdict: str


def check_claims(run: Run) -> list[Claim]:
    """Check all claims for which the run has results; none if a row has no statistics."""
    if not all(row.statistics for row in run.results.rows):
        return []
    checks = (_lateral_counts, _damping, _stacking, _large, _learning, _vertical, _avoidance)
    return [claim for check in checks for claim in check(run)]


def claims_table(claims: Sequence[Claim]) -> Table:
    """One line per claim."""
    header = ("claim", "paper", "criterion", "measured", "verdict")
    rows = [(each.words, each.paper, each.asked, each.found, each.verdict) for each in claims]
    return Table(header, tuple(rows))


def _lateral_counts(run: Run) -> Iterator[Claim]:
    words = "undamped policies issue an instruction at almost every step"
    yield from _count(run, "lateral", words, "lateral-undamped")
    yield from _count(run, "lateral", "instructions per scenario, damped", "lateral")
    words = "clearances per scenario, damped and stacked"
    yield from _count(run, "lateral", words, "lateral", True)
    yield from _count(run, "lateral", "instructions per scenario, 37 actions", "lateral-large")


def _count(
    run: Run, family: str, words: str, experiment: str, stacking: bool = False
) -> Iterator[Claim]:
    """Whether the mean is within one of the paper's standard deviations of the paper's mean."""
    mean, spread = PAPER[experiment, stacking]
    found = [
        _found(
            run,
            _within(row.clearances_mean, mean - spread, mean + spread),
            f"{_settings(row)}: {_clearances(row)}",
            row,
        )
        for row in _variants(run, experiment, stacking)
        if row.clearances_mean is not None
    ]
    criterion = "within the paper's mean ± standard deviation"
    yield from _claim(family, words, f"{mean} ± {spread}", criterion, found)


def _damping(run: Run) -> Iterator[Claim]:
    undamped = run.results.row("lateral-undamped", False)
    if undamped is None:
        return
    found = []
    for row in _variants(run, "lateral", False):
        cut = _reduction(undamped, row, "instructions")
        figures = f"{_settings(row)}: {_rate(cut)}"
        found.append(_found(run, _within(cut, 0.82, 0.92), figures, undamped, row))
    words = "damping reduces instructions by about 87 %"
    yield from _claim("lateral", words, "113.0 to 14.5", "reduction of 82 to 92 %", found)


def _stacking(run: Run) -> Iterator[Claim]:
    found = []
    for plain, stacked in _plain_and_stacked(run, "lateral"):
        cut = _reduction(plain, stacked, "clearances")
        gained = _value(stacked, "success") - _value(plain, "success")
        figures = f"{_settings(stacked)}: {_rate(cut)}, success {100.0 * gained:+.1f} points"
        holds = not _below(cut, 0.4) and not _below(gained, -EQUAL)
        found.append(_found(run, holds, figures, plain, stacked))
    words = "stacking roughly halves the clearances at equal success"
    criterion = "reduction of 40 % or more, success at most 1 point lower"
    yield from _claim("lateral", words, "14.5 to 7.2", criterion, found)
    found = []
    for plain, stacked in _plain_and_stacked(run, "lateral-undamped"):
        cut = _reduction(plain, stacked, "clearances")
        figures = f"{_clearances(plain)} to {_clearances(stacked)}: {_rate(cut)}"
        found.append(_found(run, _below(cut, 0.2), figures, plain, stacked))
    words = "stacking hardly helps undamped policies"
    yield from _claim("lateral", words, NOTHING, "reduction of less than 20 %", found)


def _large(run: Run) -> Iterator[Claim]:
    large = run.results.row("lateral-large", False)
    if large is None:
        return
    found = []
    for row in _variants(run, "lateral", True):
        more = _below(_value(large, "clearances"), _value(row, "clearances"))
        worse = _below(_value(row, "success"), _value(large, "success") - EQUAL)
        rates = f"success {_value(row, 'success'):.3f} against {_value(large, 'success'):.3f}"
        counts = f"{_settings(row)}: {_clearances(row)} against {_clearances(large)}"
        found.append(_found(run, not more and not worse, f"{counts}, {rates}", row, large))
    words = "5 actions with stacking perform as well as 37 actions"
    criterion = "no more clearances, success at most 1 point lower"
    yield from _claim("lateral", words, "7.2 against 6.3", criterion, found)
    yield from _significance(run)


def _significance(run: Run) -> Iterator[Claim]:
    """Welch's test on the paper's numbers, and the interval of the measured difference."""
    (stacked, its_spread), (large, spread) = PAPER["lateral", True], PAPER["lateral-large", False]
    p = ttest_ind_from_stats(
        stacked, its_spread, SCENARIOS, large, spread, SCENARIOS, equal_var=False
    ).pvalue
    found = []
    for row in _variants(run, "lateral", True):
        gap = _difference(run, row, "lateral-large")
        if gap is not None:
            holds = gap.low <= 0.0 <= gap.high
            figures = f"{_settings(row)}: {interval(gap)}"
            found.append(_found(run, holds, figures, row, run.results.row("lateral-large", False)))
    yield from _claim(
        "lateral",
        "the difference between 6.3 and 7.2 is not significant",
        f"p = {p:.3f} (Welch's test on the paper's numbers)",
        "the interval of the difference contains 0",
        found,
    )


def _learning(run: Run) -> Iterator[Claim]:
    small, large = _curves(run, "lateral"), _curves(run, "lateral-large")
    if not small or not large:
        return
    rows = [run.results.row(name, False) for name in ("lateral", "lateral-large")]
    steps = [median(map(_converged, seeds)) for seeds in (small, large)]
    yield from _claim(
        "lateral",
        "the small action space converges faster",
        "earlier and more reliable success",
        f"{_rate(LEARNED)} success after fewer steps, median over seeds",
        [_found(run, steps[0] < steps[1], " against ".join(map(_million, steps)), *rows)],
    )
    fields = ("correct_exit", "excursion", "few_instructions")
    exits, inside, few = (_final_rate(large, field) for field in fields)
    if exits is None or inside is None or few is None:
        return
    figures = (
        f"at the end of training: correct exit {_rate(exits)}, no excursion {_rate(inside)}, "
        f"few instructions {_rate(few)}"
    )
    yield from _claim(
        "lateral",
        "the count criterion limits the success of 37 actions",
        NOTHING,
        "the count criterion is met less often than the other two",
        [_found(run, _below(few, min(exits, inside) - EQUAL), figures, *rows)],
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
    words = "a burst of fifteen instructions becomes one clearance"
    found = [_found(run, holds, figures, plain, stacked)]
    yield from _claim("vertical", words, "15 to 1", "one clearance in every case", found)


def _avoidance(run: Run) -> Iterator[Claim]:
    words = "clearances per scenario, avoidance, stacked"
    yield from _count(run, "avoidance", words, "avoidance", True)
    words = "instructions per scenario, avoidance, 37 actions"
    yield from _count(run, "avoidance", words, "avoidance-large")
    rows = _variants(run, "avoidance", True)
    lost = [(row, row.statistics["loss_of_separation"].mean) for row in rows]
    found = [
        _found(
            run,
            not _below(0.01, rate.value),
            f"{_settings(row)}: {percent_interval(rate)}",
            row,
        )
        for row, rate in lost
    ]
    words = "separation is lost in 1 of 100 scenarios"
    yield from _claim("avoidance", words, "1 %", "1 % or less", found)
    large = run.results.row("avoidance-large", False)
    if large is None:
        return
    theirs = large.statistics["loss_of_separation"].mean
    found = [
        _found(
            run,
            _below(rate.value, theirs.value),
            f"{_settings(row)}: {percent_interval(rate)} against {percent_interval(theirs)}",
            row,
            large,
        )
        for row, rate in lost
    ]
    words = "with stacking, separation is lost less often than with 37 actions"
    yield from _claim("avoidance", words, "1 against 9 of 100", "lower mean", found)
    found = [
        _found(
            run,
            _below(_value(row, "clearances"), _value(large, "clearances")),
            f"{_settings(row)}: {_clearances(row)} against {_clearances(large)}",
            row,
            large,
        )
        for row in rows
    ]
    words = "with stacking, there are fewer clearances than with 37 actions"
    yield from _claim("avoidance", words, "81.2 against 126.3", "lower mean", found)


NOT_TRAINED = " (not trained)"


def _claim(
    family: str, words: str, paper: str, criterion: str, found: Sequence[Found]
) -> Iterator[Claim]:
    """The verdict on a claim. The first finding is for the paper's settings."""
    if found:
        figures = "; ".join(each.figures + ("" if each.judged else NOT_TRAINED) for each in found)
        yield Claim(family, words, paper, criterion, figures, _verdict(found))


def _found(run: Run, holds: bool, figures: str, *rows: Row | None) -> Found:
    """A finding about some rows. A row that is missing counts as not trained."""
    judged = all(row is not None and run.results.is_trained(row) for row in rows)
    changed = any(row is not None and _is_tuned(row) for row in rows)
    return Found(holds, figures, judged, changed)


def _verdict(found: Sequence[Found]) -> str:
    holding = [each for each in found if each.judged and each.holds]
    if any(not each.changed for each in holding):
        return REPRODUCED
    if holding:
        return CHANGED
    return MISSED if found[0].judged else UNDECIDED


def _variants(run: Run, experiment: str, stacking: bool) -> list[Row]:
    """The row with the paper's settings, then the one with changed settings, if they exist."""
    names = (experiment, f"{experiment}-tuned")
    rows = [run.results.row(name, stacking) for name in names]
    return [row for row in rows if row is not None]


def _plain_and_stacked(run: Run, experiment: str) -> list[tuple[Row, Row]]:
    plain = _variants(run, experiment, False)
    both = [(row, run.results.row(row.experiment, True)) for row in plain]
    return [(row, stacked) for row, stacked in both if stacked is not None]


def _below(value: float, other: float) -> bool:
    """Whether a value is lower by more than the rounding tolerance."""
    return value < other - ROUNDING


def _within(value: float, low: float, high: float) -> bool:
    """Whether a value is in a closed interval."""
    return not _below(value, low) and not _below(high, value)


def _value(row: Row, measure: str) -> float:
    return row.statistics[measure].mean.value


def _reduction(before: Row, after: Row, measure: str) -> float:
    """The relative reduction of a count; 0 if it was 0."""
    count = _value(before, measure)
    return 1.0 - _value(after, measure) / count if count else 0.0


def _settings(row: Row) -> str:
    return "tuned" if _is_tuned(row) else "as stated"


def _is_tuned(row: Row) -> bool:
    """Whether the row's experiment changes some of the paper's settings."""
    return row.experiment.endswith("-tuned")


def _clearances(row: Row) -> str:
    return interval(row.statistics["clearances"].mean)


def _difference(run: Run, row: Row, other: str) -> Estimate | None:
    """The difference in clearances between a stacked row and another, unstacked one."""
    wanted = RowName(row.experiment, True), RowName(other, False)
    for each in run.results.comparisons:
        if (each.first, each.second) == wanted:
            return each.measures["clearances"].difference
    return None


def _curves(run: Run, experiment: str) -> list[list[Update]]:
    return [
        run.updates(training) for training in run.results.train if training.experiment == experiment
    ]


def _converged(updates: Sequence[Update]) -> float:
    """Steps until the policy has learned its task; infinite if it never does."""
    steps = steps_until(LEARNED, [updates])
    return np.inf if steps is None else steps


def _final_rate(seeds: Sequence[Sequence[Update]], field: str) -> float | None:
    """A rate at the end of training, as a mean over seeds; None if unknown.

    For `excursion` it is the rate of scenarios without one.
    """
    known = [end for end in (at_the_end(updates, field) for updates in seeds) if end is not None]
    return float(np.mean(known)) if known else None


def _rate(value: float) -> str:
    return f"{100.0 * value:.0f} %"


def _million(steps: float) -> str:
    return f"{steps / 1e6:.2f} million steps" if np.isfinite(steps) else "never"


def _climbs(run: Run, row: Row) -> np.ndarray:
    """Clearances of the first seed in scenarios with the paper's change of level."""
    folder = run.evaluation(row)
    aircraft = read_table(folder / "aircraft.parquet", ("scenario", "entry_fl", "exit_fl"))
    entry, leave = (aircraft[name].to_numpy() for name in ("entry_fl", "exit_fl"))
    chosen = aircraft["scenario"].to_numpy()[np.abs(leave - entry) == CLIMB_FL]
    episodes = read_table(folder / "episodes.parquet", ("scenario", "clearances"))
    wanted = np.isin(episodes["scenario"].to_numpy(), chosen)
    clearances: np.ndarray = episodes["clearances"].to_numpy()[wanted]
    return clearances
