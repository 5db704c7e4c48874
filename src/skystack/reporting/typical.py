"""The choice of the scenario that the pictures of a family show."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from skystack.reporting.flights import Outcomes, Start, read_outcomes, read_starts
from skystack.reporting.results import Row, Run

CANDIDATES = 100
"""The number of scenarios among which one is chosen: as many as in the paper's evaluations."""
CLIMB_FL = 150
"""The paper shows a climb of 15 instructions, 10 levels each."""


def typical_scenario(run: Run, rows: Sequence[Row]) -> int:
    """The number of a scenario that resembles the paper's, requires action and is typical.

    In avoidance, one aircraft's route is the reverse of the other's. In vertical control, the exit
    level is 150 flight levels above the entry level, or else the climb is the largest of any
    scenario. If there is no such scenario, all are candidates. Among the candidates, these take
    precedence, in this order:

    1. Every policy succeeds.
    2. Doing nothing fails, every policy acts, and the policies differ in their clearances.
    3. The clearances are close to the mean of each row, measured in the row's standard deviations.

    Only trained policies count.
    """
    acting = _acting(run, rows)
    if not acting:
        return 0
    family = acting[0].family
    # Such a climb is rare, so the search covers all scenarios.
    most = None if family == "vertical" else CANDIDATES
    flown = [read_outcomes(run.evaluation(row), most) for row in acting]
    idle = [read_outcomes(run.evaluation(row), most) for row in rows if row.is_no_op]
    common = min(len(outcomes.scenario) for outcomes in (*flown, *idle))
    if not common:
        return 0
    numbers = [int(number) for number in flown[0].scenario[:common]]
    unlike = ~resembles_paper(family, read_starts(run.evaluation(acting[0]), numbers))
    failed = ~np.all([outcomes.success[:common] for outcomes in flown], axis=0)
    dull = ~_differ([outcomes.clearances[:common] for outcomes in flown])
    dull |= np.any([outcomes.success[:common] for outcomes in idle] or [dull], axis=0)
    distance = np.sum([_distance_from_mean(outcomes)[:common] for outcomes in flown], axis=0)
    return numbers[int(np.lexsort((distance, dull, failed, unlike))[0])]


def _acting(run: Run, rows: Sequence[Row]) -> list[Row]:
    """The rows of trained policies."""
    return [row for row in rows if not row.is_no_op and run.results.is_trained(row)]


def _differ(clearances: Sequence[Int[np.ndarray, " scenarios"]]) -> Bool[np.ndarray, " scenarios"]:
    """In which scenarios every policy acts, and not all issue as many clearances."""
    counts = np.stack(clearances)
    differ = np.any(counts != counts[0], axis=0) | (len(counts) == 1)
    return np.all(counts > 0, axis=0) & differ


def kind_of_scenario(run: Run, rows: Sequence[Row], number: int) -> str | None:
    """What the chosen scenario has in common with the paper's, in words; None if nothing."""
    acting = _acting(run, rows)
    if not acting:
        return None
    family, (start,) = acting[0].family, read_starts(run.evaluation(acting[0]), [number])
    if family == "vertical" and max(start.climbs_fl) == CLIMB_FL:
        return f"a climb of {CLIMB_FL} flight levels"
    if family == "avoidance" and start.reciprocal:
        return "two aircraft on reciprocal routes"
    return None


def resembles_paper(family: str, starts: Sequence[Start]) -> Bool[np.ndarray, " scenarios"]:
    """Which scenarios resemble the one in the paper; in lateral navigation, all do."""
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
