"""The phases of a training and their programs: the next one's is made while one trains."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

import jax
import msgspec

from skystack.io.signals import wait_for
from skystack.learning import ppo
from skystack.learning.experiment import Experiment
from skystack.learning.settings import PPOSettings
from skystack.tasks.build import build_training_task
from skystack.tasks.contract import Task

CompiledUpdate = Callable[[ppo.TrainState], tuple[ppo.TrainState, dict[str, jax.Array]]]
"""`ppo.update` of a phase, compiled."""


def phases(experiment: Experiment, task: Task, first: int) -> dict[int, Task]:
    """The task to train on from an update on: pre-training's until its steps are done.

    Only what is still trained on after `first` updates.
    """
    before, settings = experiment.pretraining, experiment.ppo
    if first >= settings.updates:
        return {}
    change = 0 if before is None else -(-before.steps // settings.samples)
    if before is None or change <= first:
        return {first: task}
    reward = msgspec.structs.replace(experiment.task, reward=before.reward)
    begun = {first: build_training_task(reward)}
    return begun | {change: task} if change < settings.updates else begun


@contextmanager
def compiled_updates(
    tasks: Mapping[int, Task], settings: PPOSettings, like: ppo.TrainState
) -> Iterator[Mapping[int, Future[CompiledUpdate]]]:
    """The program of each phase, made in a thread beside the caller's, the first one first.

    `like` has the learner's shapes and types; its arrays are not looked at. What is not begun when
    the caller leaves is not made; what is begun is waited for.
    """
    maker = ThreadPoolExecutor(1, thread_name_prefix="compile")
    try:
        yield {first: maker.submit(_compile, task, settings, like) for first, task in tasks.items()}
    finally:
        maker.shutdown(cancel_futures=True)


def run_updates(
    updates: Mapping[int, Future[CompiledUpdate]], settings: PPOSettings, learner: ppo.TrainState
) -> Iterator[tuple[int, ppo.TrainState, dict[str, jax.Array]]]:
    """Train to the end: how many updates are made, the learner and what was measured, each time."""
    for number in range(int(learner.updates), settings.updates):
        if number in updates:
            update = wait_for(updates[number])
        learner, measured = update(learner)
        yield number + 1, learner, measured


def _compile(task: Task, settings: PPOSettings, like: ppo.TrainState) -> CompiledUpdate:
    # Nothing is donated, so that the old learner is whole whenever an interruption comes.
    compiled: CompiledUpdate = jax.jit(partial(ppo.update, task, settings)).lower(like).compile()
    return compiled
