"""The registry of tasks: the paper's tasks and custom ones.

A custom task needs a `TaskKind` and a call of `register_task`, or an entry point in the group
`skystack.tasks` of an installed package. Training, evaluation, replay and reports then support it
like the paper's tasks.
"""

from functools import cache
from importlib.metadata import entry_points

from skystack.errors import InputError, unknown_name
from skystack.tasks.contract import Task, TrafficTask
from skystack.tasks.kinds import TaskKind
from skystack.tasks.navigation_kinds import NAVIGATION_KINDS
from skystack.tasks.sector_kind import SECTOR_KIND
from skystack.tasks.settings import TaskSettings

ENTRY_POINTS = "skystack.tasks"
"""The group of entry points. Each must refer to a `TaskKind`."""

_TASKS: dict[str, TaskKind] = {kind.name: kind for kind in (*NAVIGATION_KINDS, SECTOR_KIND)}


def register_task(kind: TaskKind) -> None:
    """Register a kind of task by its name. Raises InputError if another kind has the same name."""
    registered = _TASKS.setdefault(kind.name, kind)
    if registered != kind:
        raise InputError(f"task {kind.name} is already registered (allowed: another name)")


def unregister_task(name: str) -> None:
    """Remove a kind of task, so that its name can be used again."""
    _TASKS.pop(name, None)


def tasks() -> dict[str, TaskKind]:
    """All registered kinds of tasks by name."""
    _load_entry_points()
    return dict(_TASKS)


def find_task(name: str) -> TaskKind:
    """The kind of task with the given name. Raises InputError if it is unknown."""
    if name not in _TASKS:
        _load_entry_points()
    if name not in _TASKS:
        raise unknown_name("task", name, _TASKS)
    return _TASKS[name]


@cache
def _load_entry_points() -> None:
    for entry_point in entry_points(group=ENTRY_POINTS):
        register_task(entry_point.load())


def build_task(settings: TaskSettings) -> Task:
    """The task for evaluation. Raises InputError for invalid settings.

    Example:

        >>> import skystack
        >>> task = skystack.build_task(skystack.load_experiment("lateral").task)
        >>> task.action_names[:2]
        ('none', 'aircraft 1 turn -10 deg')
    """
    if not isinstance(settings, TaskSettings):  # most likely an experiment
        raise InputError(
            f"settings is of type {type(settings).__name__} (allowed: TaskSettings, for example "
            "load_experiment(NAME).task)"
        )
    return find_task(settings.name).build(settings)


def build_traffic_task(settings: TaskSettings) -> TrafficTask:
    """Like `build_task`, but for traffic tasks only. Raises InputError for other tasks."""
    task = build_task(settings)
    if not isinstance(task, TrafficTask):
        raise InputError(
            f"task {task.name} has no traffic (allowed: tasks that implement TrafficTask in "
            "skystack.tasks.contract)"
        )
    return task


def build_training_task(settings: TaskSettings) -> Task:
    """The task for training. Its steps depend on the setting `timing`."""
    task = build_task(settings)
    return find_task(settings.name).stacked(task) if settings.timing == "stack" else task


def check_cycles(task: Task) -> str | None:
    """Check whether a task's scenarios can be finished within its time limit.

    Returns a notice for the user or None. Raises InputError if no scenario can be finished.
    """
    return find_task(task.name).check_cycles(task)
