"""Evaluate one policy on the same scenarios in several simulators, ours first."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from skystack.errors import PlatformError
from skystack.evaluation.agreement import same_clearances
from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.summary import RowValues
from skystack.learning.policy import Policy

ScenarioCounter = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]
"""Displays the number of finished scenarios: `skystack.cli.console.count_scenarios`."""


class CrossPlatform(NamedTuple):
    """The results on all platforms."""

    rows: list[RowValues]
    """Rows of other platforms have `same_clearances_rate`: the share of scenarios with the same
    clearances as in our simulator (`skystack.evaluation.agreement`)."""
    failed: list[str]
    """The scenarios that a platform did not finish, each with the reason."""


def evaluate_on_platforms(
    policy: Policy, platforms: Sequence[str], episodes: int, out: Path, count: ScenarioCounter
) -> CrossPlatform:
    """Evaluate plain and stacked on scenarios 0, 1, ...; write other platforms' tables to `out`."""
    rows: list[RowValues] = []
    failed: list[str] = []
    for stacking in (False, True):
        conditions = Conditions(episodes=episodes, stacking=stacking)
        ours = evaluate(policy, conditions, None)
        rows.append(ours.row)
        for platform in platforms:
            name = f"{policy.description.experiment} {platform}"
            on_platform = conditions._replace(platform=platform)
            try:
                with count(name, episodes) as on_scenario:
                    theirs = evaluate(policy, on_platform, out, on_scenario)
            except PlatformError as error:
                failed.append(f"{name}: {error}")
                continue
            numbers = theirs.episodes["scenario"].to_pylist()
            same = same_clearances(ours.clearances, theirs.clearances, numbers)
            rows.append(theirs.row | {"same_clearances_rate": sum(same) / len(same)})
            failed += [f"{name}: scenario {number} {why}" for number, why in theirs.failed.items()]
    return CrossPlatform(rows, failed)
