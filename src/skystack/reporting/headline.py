"""The result of a run in a few sentences."""

from collections.abc import Iterator

from skystack.reporting.families import family_title
from skystack.reporting.results import Row, Run
from skystack.reporting.tables import decimal, percent


def headline(run: Run) -> Iterator[str]:
    """What stacking achieved, for the paper's policy and for ours, in each family.

    A policy that is not trained is not mentioned.
    """
    quick = ", trained briefly" if run.results.quick else ""
    for family in run.results.families:
        plain, stacked = (_row(run, family, way) for way in (False, True))
        if plain is not None and stacked is not None:
            yield (
                f"{family_title(family)} with the paper's settings{quick}: stacking reduces the "
                f"clearances per scenario from {decimal(plain.clearances_mean)} to "
                f"{decimal(stacked.clearances_mean)}, at {percent(stacked.success_rate)} success."
            )
        best, bound = _row(run, f"{family}-best", True), run.bound_of(family)
        if best is not None:
            least = "" if bound is None else decimal(bound.clearances_mean)
            yield (
                f"{family_title(family)} with our own settings{quick}, stacked: "
                f"{decimal(best.clearances_mean)} clearances per scenario, at "
                f"{percent(best.success_rate)} success{least and f' (fewest possible: {least})'}."
            )


def _row(run: Run, experiment: str, stacking: bool) -> Row | None:
    row = run.results.row(experiment, stacking)
    return row if row is not None and run.results.is_trained(row) else None
