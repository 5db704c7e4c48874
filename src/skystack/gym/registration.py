"""Environments from the name of an experiment, a file, or settings: what Gymnasium calls."""

from gymnasium.vector import AutoresetMode

from skystack.gym.environment import TaskEnvironment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.learning.experiment import load_experiment
from skystack.tasks.build import build_training_task
from skystack.tasks.contract import Task
from skystack.tasks.settings import TaskSettings


def training_task(experiment: str, settings: TaskSettings | None = None) -> Task:
    """The task as a learner steps through it: of settings where given, else of an experiment.

    `experiment` is a name that `skystack list` shows, or the path of a `.toml` file. Where its
    `task.timing` is `stack`, a step is an instruction or a cycle, as for our own trainer.
    Raises InputError for what does not exist or cannot be.
    """
    return build_training_task(load_experiment(experiment).task if settings is None else settings)


def make_environment(
    experiment: str, settings: TaskSettings | None = None, render_mode: str | None = None
) -> TaskEnvironment:
    """One scenario at a time; see `training_task`."""
    return TaskEnvironment(training_task(experiment, settings), render_mode)


def make_vector_environment(
    experiment: str,
    num_envs: int = 1,
    settings: TaskSettings | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
) -> VectorTaskEnvironment:
    """Many scenarios at once; see `training_task`."""
    task = training_task(experiment, settings)
    return VectorTaskEnvironment(task, num_envs, autoreset_mode, max_episode_steps)
