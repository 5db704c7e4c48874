"""Which scenario a family's pictures show."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from skystack.reporting.flights import Outcomes, Start, read_outcomes, read_starts
from skystack.reporting.histograms import SCENARIOS
from skystack.reporting.results import NO_OP_NAME, Row, Run

CLIMB_FL = 150
"""The paper shows a climb of 15 instructions, 10 levels each."""


def typical_scenario(run: Run, rows: Sequence[Row]) -> int:
    """The scenario of a family's pictures: like the paper's, and typical among those.

    For avoidance one aircraft's route is the other's reversed; for vertical control the exit level
    is 150 levels above the entry level, or else as far above as there is. Where there is none such,
    all scenarios count. Among them those in which every policy succeeds come first; then that
    whose clearances lie nearest to every row's own mean, in each row's standard deviations.
    """
    acting = [row for row in rows if row.experiment != NO_OP_NAME]
    if not acting:
        return 0
    family = acting[0].family
    # Such a climb is rare: it is sought beyond the scenarios of the histograms.
    most = None if family == "vertical" else SCENARIOS
    flown = [read_outcomes(run.evaluation(row), most) for row in acting]
    common = min(len(outcomes.scenario) for outcomes in flown)
    if not common:
        return 0
    numbers = [int(number) for number in flown[0].scenario[:common]]
    unlike = ~like_the_papers(family, read_starts(run.evaluation(acting[0]), numbers))
    failed = ~np.all([outcomes.success[:common] for outcomes in flown], axis=0)
    distance = np.sum([_distance_from_mean(outcomes)[:common] for outcomes in flown], axis=0)
    return numbers[int(np.lexsort((distance, failed, unlike))[0])]


def kind_of_scenario(run: Run, rows: Sequence[Row], number: int) -> str | None:
    """What the chosen scenario has in common with the paper's, in words; None if nothing."""
    acting = [row for row in rows if row.experiment != NO_OP_NAME]
    if not acting:
        return None
    family, (start,) = acting[0].family, read_starts(run.evaluation(acting[0]), [number])
    if family == "vertical" and max(start.climbs_fl) == CLIMB_FL:
        return f"a climb of {CLIMB_FL} levels"
    if family == "avoidance" and start.reciprocal:
        return "two aircraft on reciprocal routes"
    return None


def like_the_papers(family: str, starts: Sequence[Start]) -> Bool[np.ndarray, " scenarios"]:
    """Which scenarios begin as the one that the paper shows does; in lateral navigation all."""
    if family == "avoidance":
        return np.array([start.reciprocal for start in starts])
    if family == "vertical":
        climbs_fl = np.array([max(start.climbs_fl) for start in starts])
        is_wanted = climbs_fl == CLIMB_FL
        return is_wanted if is_wanted.any() else climbs_fl == climbs_fl.max()
    return np.ones(len(starts), dtype=bool)


def _distance_from_mean(outcomes: Outcomes) -> Float[np.ndarray, " scenarios"]:
    spread = max(float(outcomes.clearances.std()), 1.0)
    distance: Float[np.ndarray, " scenarios"] = np.square(
        (outcomes.clearances - outcomes.clearances.mean()) / spread
    )
    return distance
