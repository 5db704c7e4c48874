"""The phases of a training run. The next phase is compiled while the current one trains."""

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
from skystack.tasks.contract import Task
from skystack.tasks.registry import build_training_task

CompiledUpdate = Callable[[ppo.TrainState], tuple[ppo.TrainState, dict[str, jax.Array]]]
"""The compiled `ppo.update` of a phase."""


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
    tasks: Mapping[int, Task], settings: PPOSettings, like: ppo.TrainState
) -> Iterator[Mapping[int, Future[CompiledUpdate]]]:
    """The program of each phase, compiled in a background thread in the order of the phases.

    `like` has the shapes and types of the train state; its values are not used. When the context
    ends, compilations that have not started are cancelled, and a running one is waited for.
    """
    executor = ThreadPoolExecutor(1, thread_name_prefix="compile")
    try:
        yield {
            first: executor.submit(_compile, task, settings, like) for first, task in tasks.items()
        }
    finally:
        executor.shutdown(cancel_futures=True)


def run_updates(
    updates: Mapping[int, Future[CompiledUpdate]],
    settings: PPOSettings,
    train_state: ppo.TrainState,
) -> Iterator[tuple[int, ppo.TrainState, dict[str, jax.Array]]]:
    """Train to the end. Yields the number of updates, the train state and the measured values."""
    for number in range(int(train_state.updates), settings.updates):
        if number in updates:
            update = wait_for(updates[number])
        train_state, measured = update(train_state)
        yield number + 1, train_state, measured


def _compile(task: Task, settings: PPOSettings, like: ppo.TrainState) -> CompiledUpdate:
    # No buffer donation: the previous train state stays valid if the run is interrupted.
    compiled: CompiledUpdate = jax.jit(partial(ppo.update, task, settings)).lower(like).compile()
    return compiled
