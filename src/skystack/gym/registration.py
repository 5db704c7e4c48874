"""The entry points for Gymnasium: environments of an experiment (a name or file) or of settings."""

from functools import lru_cache

import msgspec
from gymnasium.vector import AutoresetMode

from skystack.errors import InputError
from skystack.gym.environment import TaskEnvironment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.io.files import AnyPath
from skystack.learning.experiment import load_experiment
from skystack.tasks.contract import ManyAgents, Task
from skystack.tasks.plain import PlainTask
from skystack.tasks.registry import build_training_task
from skystack.tasks.settings import TaskSettings


def settings_of(experiment: AnyPath, settings: TaskSettings | None = None) -> TaskSettings:
    """`settings` if given, otherwise those of the experiment.

    `experiment` is a name that `skystack list` prints, or the path of a `.toml` file. Environments
    step as skystack's own trainer does: where `timing` is `stack`, a step is one instruction or one
    cycle. Raises InputError for an unknown experiment.
    """
    return load_experiment(experiment).task if settings is None else settings


def make_environment(
    experiment: AnyPath,
    settings: TaskSettings | None = None,
    render_mode: str | None = None,
) -> TaskEnvironment:
    """An environment of one scenario at a time; `settings_of` explains the first two arguments.

    Environments with equal settings share one set of compiled programs.
    """
    chosen = settings_of(experiment, settings)
    task, programs = _compiled(type(chosen), msgspec.json.encode(chosen))
    _check_one_agent(task)
    return TaskEnvironment(task, render_mode, programs)


def make_vector_environment(
    experiment: AnyPath,
    num_envs: int = 1,
    settings: TaskSettings | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    render_mode: str | None = None,
) -> VectorTaskEnvironment:
    """An environment of many scenarios; `settings_of` and its class explain the arguments."""
    task = build_training_task(settings_of(experiment, settings))
    _check_one_agent(task)
    return VectorTaskEnvironment(task, num_envs, autoreset_mode, max_episode_steps, render_mode)


def _check_one_agent(task: Task) -> None:
    if isinstance(task, ManyAgents):
        raise InputError(
            f"task {task.name} has many agents (allowed: tasks with one agent; for this task, use "
            "skystack.gym.sector.make_sector_environment or skystack.gym.flights.flights_env)"
        )


@lru_cache(maxsize=16)
def _compiled(kind: type[TaskSettings], settings: bytes) -> tuple[Task, PlainTask]:
    """The key is the settings as JSON, because a sector in them cannot be hashed."""
    task = build_training_task(msgspec.json.decode(settings, type=kind))
    return task, PlainTask(task)
