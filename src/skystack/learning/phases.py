"""The phases of a training run. The next phase is compiled while the current one trains."""

from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import jax
import msgspec

from skystack.io.signals import wait_for
from skystack.learning.collection import TrainState
from skystack.learning.experiment import Experiment
from skystack.learning.parts import Update, compile_update
from skystack.learning.settings import PPOSettings
from skystack.tasks.contract import Task
from skystack.tasks.registry import build_training_task


def phases(experiment: Experiment, task: Task, first: int) -> dict[int, Task]:
    """The tasks to train on, by the update at which each starts: pre-training, then `task`.

    Only phases that remain after `first` updates are included.
    """
    pretraining, settings = experiment.pretraining, experiment.ppo
    if first >= settings.updates:
        return {}
    change = 0 if pretraining is None else -(-pretraining.steps // settings.samples)
    if pretraining is None or change <= first:
        return {first: task}
    pretraining_settings = msgspec.structs.replace(experiment.task, reward=pretraining.reward)
    first_phase = {first: build_training_task(pretraining_settings)}
    return first_phase | {change: task} if change < settings.updates else first_phase


@contextmanager
def compiled_updates(
    tasks: Mapping[int, Task], settings: PPOSettings, like: TrainState
) -> Iterator[Mapping[int, Future[Update]]]:
    """The program of each phase, compiled in a background thread in the order of the phases.

    `like` has the shapes and types of the train state; its values are not used. When the context
    ends, compilations that have not started are cancelled, and a running one is waited for.
    """
    executor = ThreadPoolExecutor(1, thread_name_prefix="compile")
    try:
        yield {
            first: executor.submit(compile_update, task, settings, like)
            for first, task in tasks.items()
        }
    finally:
        executor.shutdown(cancel_futures=True)


def run_updates(
    updates: Mapping[int, Future[Update]],
    settings: PPOSettings,
    train_state: TrainState,
) -> Iterator[tuple[int, TrainState, dict[str, jax.Array]]]:
    """Train to the end. Yields the number of updates, the train state and the measured values."""
    for number in range(int(train_state.updates), settings.updates):
        if number in updates:
            update = wait_for(updates[number])
        train_state, measured = update(train_state)
        yield number + 1, train_state, measured
