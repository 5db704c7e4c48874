"""The families of experiments: each is a task, and a section of the reports."""

from collections.abc import Iterable

from skystack.evaluation.summary import is_no_op
from skystack.tasks.registry import tasks

BOUND_FAMILY = "lateral"
"""The family for which the fewest possible clearances are known."""
OTHER_FAMILY = "other"
"""The family of unknown experiments in old files, which do not state the task."""


def family_of(experiment: str, task: str | None) -> str:
    """The family of an experiment, which is its task.

    Old files do not state the task. It is then derived from the name of the experiment.
    """
    if task is not None:
        return task
    if is_no_op(experiment):
        return BOUND_FAMILY
    word = experiment.partition("-")[0]
    return word if word in tasks() else OTHER_FAMILY


def family_title(family: str) -> str:
    """The title of a family's section."""
    known = tasks()
    return known[family].family.title if family in known else family.capitalize()


def family_order(families: Iterable[str]) -> list[str]:
    """Sort families in the order of the task registry, unknown ones last."""
    known = list(tasks())
    return sorted(
        set(families),
        key=lambda name: (known.index(name) if name in known else len(known), name),
    )
