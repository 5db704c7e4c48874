"""A model card, `README.md`: what a policy is, how it was trained, and how well it performs.

It begins with metadata in the format of the Hugging Face hub, which reads a model's card from a
file of this name: the folder of a policy can be uploaded as it is.
"""

import textwrap
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jinja2
import msgspec

from skystack.agents.safety_net import ALERT_S, AREA_ALERT_S
from skystack.agents.sector_agents import sector_task_of
from skystack.evaluation.evaluate import policy_task
from skystack.learning.experiment import (
    Experiment,
    experiment_from,
    experiment_names,
    load_experiment,
)
from skystack.learning.policy import Policy
from skystack.policies.measured import Measured
from skystack.reporting.hour_table import hours_in_words, traffic_in_words
from skystack.reporting.page import template_source
from skystack.reporting.tables import NOTHING, decimal, mean_and_std, percent
from skystack.tasks.contract import Action, TrafficTask
from skystack.tasks.kinds import TaskKind
from skystack.tasks.registry import find_task
from skystack.tasks.rewards import MAX_INSTRUCTIONS
from skystack.tasks.sector_control import SectorControl

FILE = "README.md"
METRICS = ("clearances_mean", "clearances_std", "success_rate")
"""The columns of the measurements that are in the metadata, `LOSSES` only with several aircraft."""
LOSSES = "loss_of_separation_count"
SECTOR_METRICS = (
    "flights",
    "losses_of_separation",
    "correct_exit_rate",
    "transmissions_per_flight",
    "lax_s_mean",
)
"""The columns of the measurements of sector control that are in the metadata."""
LONGEST_LINE = 100


class Term(NamedTuple):
    """A line of the table of rewards."""

    name: str
    description: str
    value: float | bool
    first_value: float | bool
    """In the first phase of training; equal to `value` if there is only one phase."""


def card(name: str, policy: Policy, measured: Measured) -> str:
    """The model card of a policy as Markdown; `name` is the name that it ships under.

    Raises InputError if this version's task differs from the policy's.
    """
    described = policy.description
    experiment = experiment_from(described.config, f"policy {name}")
    kind = find_task(experiment.task.name)
    values = {
        "name": name,
        "policy": described,
        "experiment": experiment,
        "sentence": _sentence(experiment),
        "description": kind.describe(experiment.task),
        "terms": list(_terms(experiment, kind)),
        "measured": measured,
    }
    if described.task_name == SectorControl.name:
        sector_task_of(policy)  # raises if the task has changed
        values |= {
            "metrics": SECTOR_METRICS,
            "alert_s": int(ALERT_S),
            "area_alert_s": int(AREA_ALERT_S),
        }
        return _rendered("sector_card.md.jinja", values)
    task = policy_task(policy)
    paper = [row["paper"] for row in measured.rows]
    values |= {
        "task": task,
        "several": task.aircraft > 1,
        "instructions": [action.name.partition(" ")[2][2:] for action in _of_first(task)],
        "most": int(MAX_INSTRUCTIONS),
        "metrics": (*METRICS, *[LOSSES] * (task.aircraft > 1)),
        "last": measured.rows[-1],
        "clearances": [_clearances(row) for row in measured.rows],
        "paper": [_clearances(each) for each in paper] if any(paper) else None,
    }
    return _rendered("model_card.md.jinja", values)


def _rendered(template: str, values: Mapping[str, Any]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(template_source),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # Markdown, from our own files
    )
    filters: dict[str, Callable[..., str]] = {
        "percent": percent,
        "decimal": decimal,
        "places": "{:.2f}".format,
        "whole": "{:,.0f}".format,
        "hours": hours_in_words,
        "number": "{:,}".format,
        "dataset": _dataset,
        "traffic": _traffic,
        "yes_or_no": lambda value: "yes" if value else "no",
        "way": _way,
        "weight": _weight,
        "options": _options,
    }
    environment.filters |= filters
    text = environment.get_template(template).render(values)
    return "".join(f"{_wrapped(line)}\n" for line in text.splitlines())


def _dataset(row: Mapping[str, Any]) -> str:
    """The name of what a row was measured on."""
    if "traffic" in row:
        net = "" if row["safety_net"] else ", no safety net"
        return f"{hours_in_words(row['hours'])} hours, {_traffic(row['traffic'])}{net}"
    return f"{row['episodes']:,} scenarios, {_way(row['stacking'])}"


def _way(stacking: bool) -> str:
    return "stacked" if stacking else "unstacked"


def _traffic(name: str) -> str:
    return traffic_in_words(name, "`{}`")


def _sentence(experiment: Experiment) -> str:
    """The description of a shipped experiment as it reads now; otherwise the policy's own."""
    if experiment.name in experiment_names():
        return load_experiment(experiment.name).description
    return experiment.description


def _wrapped(line: str) -> str:
    """A line of prose, broken if it is too long; rows of tables and code stay as they are."""
    if len(line) <= LONGEST_LINE or line.startswith(("|", "    ")):
        return line
    indent = "  " if line.startswith("- ") else ""
    return textwrap.fill(
        line, LONGEST_LINE, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _options(command: str) -> str:
    """The options of an `evaluate` command, without the name of the policy and the output format.

    They tell the evaluations of one policy apart.
    """
    return " ".join(word for word in command.split()[3:] if word != "--json")


def _weight(value: float | bool) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}"


def _clearances(row: Mapping[str, Any] | None) -> str:
    return mean_and_std(row["clearances_mean"], row["clearances_std"]) if row else NOTHING


def _of_first(task: TrafficTask) -> list[Action]:
    """The instructions for the first aircraft; the other aircraft have the same."""
    return [action for action in task.actions if action.aircraft == 0]


def _terms(experiment: Experiment, kind: TaskKind) -> Iterator[Term]:
    """The terms of the reward that have a weight in either phase of training."""
    settings: Any = experiment.task
    terms = first = kind.describe(settings).rewards
    if experiment.pretraining is not None:
        before = msgspec.structs.replace(settings, reward=experiment.pretraining.reward)
        first = kind.describe(before).rewards
    for now, then in zip(terms, first, strict=True):
        if now.is_paid or then.is_paid:
            yield Term(now.name, now.description, now.value, then.value)
