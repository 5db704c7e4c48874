"""Kinds of tasks: the name, the settings and the function that builds a task from them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from skystack.tasks.contract import Task
from skystack.tasks.settings import TaskSettings
from skystack.tasks.stacked_steps import StackedSteps


class Family(NamedTuple):
    """A group of experiments with comparable results: one task on one kind of scenarios."""

    name: str
    title: str
    """The heading of its section in reports."""


class ObservedValue(NamedTuple):
    """An observed value. Its range is scaled to [0, 1]."""

    name: str
    description: str
    low: float
    high: float


class RewardTerm(NamedTuple):
    """The weight of a reward term, or a parameter of one."""

    name: str
    description: str
    value: float | bool
    is_paid: bool
    """Whether the weight of its term is not zero."""


class TaskDescription(NamedTuple):
    """The description of a task with given settings, for model cards."""

    summary: str
    """Completes the sentence "its task is"."""
    observed: tuple[ObservedValue, ...] = ()
    rewards: tuple[RewardTerm, ...] = ()
    criteria: tuple[str, ...] = ()
    """The criteria that a success must satisfy."""
    counts_instructions: bool = False
    """Whether a small number of instructions is also a criterion."""
    observes_others: bool = False
    """Whether features of pairs of aircraft are observed."""


def _no_check(task: Any) -> None:
    return None


def _no_description(settings: TaskSettings) -> TaskDescription:
    return TaskDescription(settings.name)


@dataclass(frozen=True)
class TaskKind:
    """A kind of task for experiments, see `skystack.tasks.registry.register_task`."""

    family: Family
    settings: type[TaskSettings]
    """The type of its `[task]` table. Pre-training requires a field `reward`."""
    build: Callable[[Any], Task]
    """Builds the task from its settings. Raises InputError for contradictory settings."""
    description: str
    """One line for `skystack list`."""
    check_cycles: Callable[[Any], str | None] = _no_check
    """Checks whether scenarios can be finished within the task's time limit. Returns a notice for
    the user or None. Raises InputError if no scenario can be finished."""
    stacked: Callable[[Any], Task] = StackedSteps
    """Makes the task with frozen time, for training with `timing = "stack"`."""
    describe: Callable[[Any], TaskDescription] = _no_description
    """The description of the task with given settings."""

    @property
    def name(self) -> str:
        return self.family.name
