"""A training run: the loop around the compiled update, files, progress and interruption."""

import hashlib
import math
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from skystack.errors import MAX_INT, InputError, checked_integer
from skystack.io.files import AnyPath, atomic_write, make_folder
from skystack.io.json_file import finite
from skystack.io.locks import check_unlocked, locked_folder
from skystack.io.signals import check
from skystack.learning import ppo
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.collection import TrainState
from skystack.learning.experiment import Experiment, resolved, to_toml
from skystack.learning.metrics_file import MetricsFile
from skystack.learning.monitor import TrainingMonitor
from skystack.learning.phases import compiled_updates, phases, run_updates
from skystack.learning.policy import (
    FORMAT,
    Policy,
    PolicyDescription,
    package_versions,
    save_policy,
)
from skystack.learning.progress import TrainingProgress
from skystack.learning.seeds import training_key
from skystack.learning.settings import PPOSettings
from skystack.tasks.contract import ManyAgents, Task
from skystack.tasks.registry import build_task, build_training_task, check_cycles

CHECKPOINT_EVERY_S = 60.0
CHECKPOINT = "learner.safetensors"


class Trained(NamedTuple):
    """A finished run."""

    policy: Policy
    steps: int
    wall_s: float
    """The training time including compilation and, in a resumed run, the earlier time recorded in
    its metrics."""

    @property
    def summary(self) -> dict[str, Any]:
        """The entry for this run in the output of `skystack train --json`."""
        return {
            "experiment": self.policy.description.experiment,
            "seed": self.policy.description.seed,
            "steps": self.steps,
            "wall_s": self.wall_s,
            "steps_per_s": self.steps / self.wall_s,
        }


def train_experiment(
    experiment: Experiment,
    seed: int,
    folder: AnyPath,
    resume: bool = False,
    on_update: Callable[[TrainingProgress], None] = lambda progress: None,
    checkpoint_every_s: float = CHECKPOINT_EVERY_S,
) -> Trained:
    """Train one seed of an experiment and write the results to a folder.

    Writes `config.toml`, `metrics.jsonl` (one line per update), `checkpoint/` and, at the end, the
    policy. A checkpoint is saved every `checkpoint_every_s` seconds (0: after every update), at the
    end, and before a KeyboardInterrupt propagates. With `resume`, training continues from the
    checkpoint, if there is one. `on_update` is called after each update, when its line is written;
    an exception in it ends the training.

    Raises TrainingError if a loss or a weight is not finite or a loss explodes; CheckpointError if
    the checkpoint cannot be resumed; InputError if the folder is not writable or is in use by
    another process.

    Example:

        >>> import skystack
        >>> short = ["ppo.total_steps=8192", "ppo.epochs=1"]
        >>> experiment = skystack.load_experiment("lateral", short)
        >>> trained = skystack.train_experiment(experiment, seed=0, folder="runs/short")
        >>> trained.steps
        8192
    """
    seed = checked_integer("seed", seed, 0, MAX_INT)
    with locked_folder(path := Path(folder), below=("checkpoint",)):
        return _train(experiment, seed, path, resume, on_update, checkpoint_every_s)


def _train(
    experiment: Experiment,
    seed: int,
    folder: Path,
    resume: bool,
    on_update: Callable[[TrainingProgress], None],
    checkpoint_every_s: float,
) -> Trained:
    started = time.monotonic()
    task, settings = _training_task(experiment), experiment.ppo
    checkpoint = make_folder(folder / "checkpoint") / CHECKPOINT
    fingerprint = hashlib.sha256(to_toml(experiment) + str(seed).encode()).hexdigest()
    init, key = jax.jit(partial(ppo.init, task, settings)), training_key(seed)
    like = jax.eval_shape(init, key)
    if not resume:  # otherwise an early kill would leave the checkpoint of the previous run
        checkpoint.unlink(missing_ok=True)
    resumed = load_checkpoint(checkpoint, like, fingerprint) if checkpoint.exists() else None
    first = int(resumed.updates) if resumed else 0
    metrics = MetricsFile(folder / "metrics.jsonl", first, started)
    monitor = TrainingMonitor(experiment.name, seed, checkpoint, first * settings.samples)

    def save(train_state: TrainState) -> None:
        metrics.sync()  # a checkpoint without its lines cannot be resumed
        save_checkpoint(checkpoint, train_state, fingerprint)
        monitor.saved_steps = int(train_state.updates) * settings.samples

    compiled = compiled_updates(phases(experiment, task, first), settings, like)
    with closing(metrics), compiled as updates:
        atomic_write(folder / "config.toml", to_toml(experiment))
        train_state = resumed or init(key)
        pace, last_saved = _Pace(settings, first), time.monotonic()
        try:
            for number, updated, measured in run_updates(updates, settings, train_state):
                check()  # an interruption may have been lost in a callback
                # Metrics are not finite if no scenario ended.
                values = {name: finite(value) for name, value in jax.device_get(measured).items()}
                steps = number * settings.samples
                monitor.check(updated, values, steps)
                metrics.append({"update": number, "steps": steps}, values)
                train_state = updated  # only after its line: a checkpoint must have all its lines
                on_update(pace.progress(number, values))
                if time.monotonic() - last_saved >= checkpoint_every_s:
                    save(train_state)
                    last_saved = time.monotonic()
        except KeyboardInterrupt:
            save(train_state)
            raise
        save(train_state)
    policy = _policy(experiment, seed, task, train_state)
    save_policy(folder, policy)
    return Trained(policy, settings.updates * settings.samples, metrics.wall_s())


def _training_task(experiment: Experiment) -> Task:
    """The task to train on. Raises InputError if its agents do not share one policy."""
    task = build_training_task(experiment.task)
    if task.agents != 1 and not isinstance(task, ManyAgents):
        raise InputError(
            f"task {task.name} has {task.agents} agents (allowed for training: 1, or several that "
            "share one policy)"
        )
    return task


def preflight(experiment: Experiment, folder: Path, resume: bool) -> list[str]:
    """Check a folder before training, and return the notices to print.

    Raises InputError if existing training results would be lost, or if the folder is in use by
    another process or not writable.
    """
    check_unlocked(folder)
    _training_task(experiment)
    cycles_notice = check_cycles(build_task(experiment.task))
    make_folder(folder / "checkpoint")
    notices = [*([] if cycles_notice is None else [cycles_notice]), "compiling ..."]
    if (folder / "policy.json").exists() and not resume:
        raise InputError(
            f"{folder}: already contains a trained policy (allowed: another folder with --out, or "
            "remove this one)"
        )
    unfinished = (folder / "checkpoint" / CHECKPOINT).exists()
    if unfinished and not resume:
        raise InputError(
            f"{folder}: contains an unfinished training run (allowed: --resume, another folder "
            "with --out, or remove this one)"
        )
    if resume and not unfinished:
        notices.insert(0, f"{folder} has no checkpoint: training starts from the beginning")
    pretraining, steps = experiment.pretraining, experiment.ppo.total_steps
    if pretraining is not None and pretraining.steps >= steps:
        notices.insert(
            0,
            f"pretraining.steps ({pretraining.steps:,}) covers all of ppo.total_steps "
            f"({steps:,}): training uses pretraining.reward only, not task.reward",
        )
    return notices


class _Pace:
    """Steps per second since the first update."""

    def __init__(self, settings: PPOSettings, first: int) -> None:
        self._settings, self._first = settings, first
        self._warm_since = math.nan

    def progress(self, number: int, values: dict[str, float | None]) -> TrainingProgress:
        settings, now = self._settings, time.monotonic()
        done = number - 1 - self._first
        self._warm_since = self._warm_since if done else now
        rate = done * settings.samples / (now - self._warm_since) if done else math.nan
        total = settings.updates * settings.samples
        return TrainingProgress(number * settings.samples, total, rate, values)


def _policy(experiment: Experiment, seed: int, task: Task, train_state: TrainState) -> Policy:
    actor, normaliser = jax.device_get((train_state.parameters.actor, train_state.normaliser))
    description = PolicyDescription(
        format=FORMAT,
        experiment=experiment.name,
        seed=seed,
        task_name=task.name,
        task_version=task.version,
        observation=task.observation_names,
        actions=task.action_names,
        hidden=experiment.ppo.hidden,
        config=resolved(experiment),
        packages=package_versions(),
        sha256="",
        git_revision=_git_revision(),
    )
    as_float32 = jax.tree.map(
        lambda array: np.asarray(array, dtype=np.float32), (actor, normaliser)
    )
    return Policy(description, *as_float32)


def _git_revision() -> str | None:
    """The git revision of the working tree that contains this package, if any."""
    try:
        result = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return result.stdout.strip()
