"""Environments from the name of an experiment, a file, or settings: what Gymnasium calls."""

from functools import lru_cache

import msgspec
from gymnasium.vector import AutoresetMode

from skystack.gym.environment import TaskEnvironment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.io.files import AnyPath
from skystack.learning.experiment import load_experiment
from skystack.tasks.build import build_training_task
from skystack.tasks.contract import Task
from skystack.tasks.plain import PlainTask
from skystack.tasks.settings import TaskSettings


def settings_of(experiment: AnyPath, settings: TaskSettings | None = None) -> TaskSettings:
    """The settings where given, else those of an experiment.

    `experiment` is a name that `skystack list` shows, or the path of a `.toml` file. Environments
    step as a learner does: where `timing` is `stack`, a step is an instruction or a cycle, as for
    our own trainer. Raises InputError for what does not exist.
    """
    return load_experiment(experiment).task if settings is None else settings


def make_environment(
    experiment: AnyPath,
    settings: TaskSettings | None = None,
    render_mode: str | None = None,
) -> TaskEnvironment:
    """One scenario at a time; arguments as of `settings_of`.

    Environments of equal settings share one set of compiled programs.
    """
    task, programs = _compiled(msgspec.json.encode(settings_of(experiment, settings)))
    return TaskEnvironment(task, render_mode, programs)


def make_vector_environment(
    experiment: AnyPath,
    num_envs: int = 1,
    settings: TaskSettings | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    render_mode: str | None = None,
) -> VectorTaskEnvironment:
    """Many scenarios at once; arguments as of `settings_of` and of the environment."""
    task = build_training_task(settings_of(experiment, settings))
    return VectorTaskEnvironment(task, num_envs, autoreset_mode, max_episode_steps, render_mode)


@lru_cache(maxsize=16)
def _compiled(settings: bytes) -> tuple[Task, PlainTask]:
    """By the settings as JSON: a sector in them cannot be hashed."""
    task = build_training_task(msgspec.json.decode(settings, type=TaskSettings))
    return task, PlainTask(task)
