"""A model card, `card.md`: what a policy is, how it was trained, and what was measured of it."""

from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any, NamedTuple

import jinja2
import msgspec

from skystack.evaluation.evaluate import policy_task
from skystack.evaluation.paper import paper_row
from skystack.learning.experiment import experiment_from
from skystack.learning.policy import Policy
from skystack.policies.measured import Measured
from skystack.reporting.tables import NOTHING, decimal, mean_and_std, percent
from skystack.tasks.features import FEATURES
from skystack.tasks.pairs import PAIR_FEATURES
from skystack.tasks.rewards import (
    CENTRELINE_SCALE_NM,
    CRITERION_BONUS,
    DAMPING_CYCLES,
    MAX_INSTRUCTIONS,
    SAFETY_SCALE_NM,
    SUCCESS_BONUS,
    VERTICAL_SCALE_FL,
)
from skystack.tasks.settings import RewardSettings, TaskSettings

FILE = "card.md"

REWARD_TERMS = {
    "centreline": f"away from the centreline: exp(-(NM / {CENTRELINE_SCALE_NM:g})²) - 1 a cycle",
    "damping": f"after an instruction: from -1 rising to 0 within {DAMPING_CYCLES:g} cycles",
    "vertical": f"off the exit level: exp(-levels / {VERTICAL_SCALE_FL:g}) - 1 a cycle",
    "safety": f"predicted closest approach: -exp(-(NM / {SAFETY_SCALE_NM:g})²), "
    "less when far apart, a cycle",
    "burst": "-1 a burst of instructions, which stacking makes one clearance",
    "outside_band": "-1 for each NM outside a band round the centreline, a cycle",
    "band_nm": "no weight: half the width of that band, NM",
    "stray": "-1 an excursion",
    "conflict": "-1 for each NM that two aircraft are nearer than they should be, a cycle",
    "conflict_nm": "no weight: how near that is, NM",
    "terminal": f"at the end: {CRITERION_BONUS:g} a criterion, {SUCCESS_BONUS:g} for all",
}
"""What a weight of 1 pays for; names are those of `RewardSettings`."""
PARAMETERS = {"band_nm": "outside_band", "conflict_nm": "conflict"}
"""Which term a setting that is no weight belongs to."""


class Term(NamedTuple):
    """A line of the table of rewards."""

    name: str
    meaning: str
    weight: float
    first_weight: float
    """In the first part of the training; the same where there is only one."""


class ObservedValue(NamedTuple):
    """A line of the table of observed values, each scaled from its range to [0, 1]."""

    name: str
    meaning: str
    low: float
    high: float


def card(name: str, policy: Policy, measured: Measured) -> str:
    """The model card of a policy as Markdown; `name` is what it ships as.

    Raises InputError where this version's task is another one than the policy's.
    """
    described = policy.description
    experiment = experiment_from(described.config, f"policy {name}")
    before = experiment.pretraining
    paper = [paper_row(described.experiment, row["stacking"]) for row in measured.rows]
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # Markdown, from our own files
    )
    environment.filters |= {
        "percent": percent,
        "decimal": decimal,
        "number": "{:,}".format,
        "way": lambda stacking: "stacked" if stacking else "unstacked",
    }
    source = files("skystack.reporting").joinpath("model_card.md.jinja").read_text("utf-8")
    return environment.from_string(source).render(
        name=name,
        policy=described,
        experiment=experiment,
        task=experiment.task,
        sector=policy_task(policy).simulator.sector,
        instructions=[each.partition(" ")[2][2:] for each in _of_first(described.actions)],
        seen=list(_seen(experiment.task)),
        terms=list(_terms(experiment.task.reward, before.reward if before else None)),
        counted=experiment.task.reward.count_criterion,
        most=int(MAX_INSTRUCTIONS),
        measured=measured,
        last=measured.rows[-1],
        clearances=[_clearances(row) for row in measured.rows],
        paper=[_clearances(each) for each in paper] if any(paper) else None,
    )


def _clearances(row: Mapping[str, Any] | None) -> str:
    return mean_and_std(row["clearances_mean"], row["clearances_std"]) if row else NOTHING


def _of_first(actions: tuple[str, ...]) -> list[str]:
    """The instructions for aircraft 1: the others have the same."""
    return [each for each in actions if each.startswith("aircraft 1 ")]


def _seen(task: TaskSettings) -> Iterator[ObservedValue]:
    for name in task.features:
        feature = FEATURES[name]
        yield ObservedValue(name, feature.meaning, feature.low, feature.high)
    for name in task.pair_features:
        pair = PAIR_FEATURES[name]
        yield ObservedValue(name, f"of the pair: {pair.meaning}", pair.low, pair.high)


def _terms(reward: RewardSettings, before: RewardSettings | None) -> Iterator[Term]:
    """What is paid for, in either part of the training."""
    settings = msgspec.structs.asdict(reward)
    first = settings if before is None else msgspec.structs.asdict(before)
    for name, meaning in REWARD_TERMS.items():
        weight = PARAMETERS.get(name, name)
        if settings[weight] or first[weight]:
            yield Term(name, meaning, settings[name], first[name])
