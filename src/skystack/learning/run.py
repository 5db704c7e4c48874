"""A training run: the loop round the compiled update, its files, progress and interruption."""

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

from skystack.errors import MOST_NUMBER, InputError, checked_whole
from skystack.io.files import AnyPath, atomic_write, make_folder
from skystack.io.locks import check_unlocked, locked_folder
from skystack.io.signals import check
from skystack.learning import ppo
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.experiment import Experiment, resolved, to_toml
from skystack.learning.metrics_file import MetricsFile
from skystack.learning.monitor import TrainingMonitor, finite
from skystack.learning.phases import compiled_updates, phases, run_updates
from skystack.learning.policy import (
    FORMAT,
    Policy,
    PolicyDescription,
    package_versions,
    save_policy,
)
from skystack.learning.seeds import training_key
from skystack.learning.settings import PPOSettings
from skystack.tasks.build import build_task, build_training_task, check_cycles
from skystack.tasks.contract import Task

CHECKPOINT_EVERY_S = 60.0
CHECKPOINT = "learner.safetensors"


class Progress(NamedTuple):
    """How far a run is, after each update."""

    steps: int
    total_steps: int
    steps_per_s: float
    """Since the first update, for which the program is compiled."""
    measured: dict[str, float | None]


class Trained(NamedTuple):
    """A finished run."""

    policy: Policy
    steps: int
    wall_s: float
    """Compilation included; of what was resumed, as long as its metrics say that it took."""

    @property
    def summary(self) -> dict[str, Any]:
        """The entry of `train` in the JSON of the command line."""
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
    on_update: Callable[[Progress], None] = lambda progress: None,
    checkpoint_every_s: float = CHECKPOINT_EVERY_S,
) -> Trained:
    """Train one seed of an experiment into a folder.

    Writes `config.toml`, `metrics.jsonl` (a line an update), `checkpoint/` (that often, 0: at every
    update, and when interrupted) and, at the end, the policy. With `resume`, goes on from the
    checkpoint if there is one. Raises TrainingError when a loss or a weight is no number or a loss
    explodes, CheckpointError for a checkpoint that cannot be gone on with, InputError for a folder
    that cannot be written to or in which another process trains; on KeyboardInterrupt the
    checkpoint is written first.
    """
    seed = checked_whole("seed", seed, 0, MOST_NUMBER)
    with locked_folder(path := Path(folder), below=("checkpoint",)):
        return _train(experiment, seed, path, resume, on_update, checkpoint_every_s)


def _train(
    experiment: Experiment,
    seed: int,
    folder: Path,
    resume: bool,
    on_update: Callable[[Progress], None],
    checkpoint_every_s: float,
) -> Trained:
    begun = time.monotonic()
    task, settings = build_training_task(experiment.task), experiment.ppo
    checkpoint = make_folder(folder / "checkpoint") / CHECKPOINT
    fingerprint = hashlib.sha256(to_toml(experiment) + str(seed).encode()).hexdigest()
    init, key = jax.jit(partial(ppo.init, task, settings)), training_key(seed)
    like = jax.eval_shape(init, key)
    if not resume:  # or a training killed soon would leave another one's checkpoint
        checkpoint.unlink(missing_ok=True)
    resumed = load_checkpoint(checkpoint, like, fingerprint) if checkpoint.exists() else None
    first = int(resumed.updates) if resumed else 0
    metrics = MetricsFile(folder / "metrics.jsonl", first, begun)
    watch = TrainingMonitor(experiment.name, seed, checkpoint, first * settings.samples)

    def save(learner: ppo.TrainState) -> None:
        metrics.sync()  # a checkpoint without its lines could not be gone on with
        save_checkpoint(checkpoint, learner, fingerprint)
        watch.saved_steps = int(learner.updates) * settings.samples

    compiled = compiled_updates(phases(experiment, task, first), settings, like)
    with closing(metrics), compiled as updates:
        atomic_write(folder / "config.toml", to_toml(experiment))
        learner = resumed or init(key)
        pace, saved = _Pace(settings, first), time.monotonic()
        try:
            for number, updated, measured in run_updates(updates, settings, learner):
                check()  # an interruption may have been lost in a callback
                values = {name: finite(value) for name, value in jax.device_get(measured).items()}
                steps = number * settings.samples
                watch.check(updated, values, steps)
                metrics.append({"update": number, "steps": steps}, values)
                learner = updated  # after its line, which is cut off if it is to be written again
                on_update(pace.progress(number, values))
                if time.monotonic() - saved >= checkpoint_every_s:
                    save(learner)
                    saved = time.monotonic()
        except KeyboardInterrupt:
            save(learner)
            raise
        save(learner)
    policy = _policy(experiment, seed, task, learner)
    save_policy(folder, policy)
    return Trained(policy, settings.updates * settings.samples, metrics.wall_s())


def preflight(experiment: Experiment, folder: Path, resume: bool) -> list[str]:
    """What must be said before a training begins in a folder.

    Raises InputError where a training would be lost, another process is at work or nothing can be
    written.
    """
    check_unlocked(folder)
    beyond = check_cycles(build_task(experiment.task))
    make_folder(folder / "checkpoint")
    said = [*([] if beyond is None else [beyond]), "compiling ..."]
    if (folder / "policy.json").exists() and not resume:
        raise InputError(
            f"{folder}: holds a trained policy already (allowed: another folder by --out, or "
            "remove this one)"
        )
    unfinished = (folder / "checkpoint" / CHECKPOINT).exists()
    if unfinished and not resume:
        raise InputError(
            f"{folder}: holds a training that is not finished (allowed: --resume, another folder "
            "by --out, or remove this one)"
        )
    if resume and not unfinished:
        said.insert(0, f"{folder} holds no checkpoint: training begins anew")
    before, steps = experiment.pretraining, experiment.ppo.total_steps
    if before is not None and before.steps >= steps:
        said.insert(
            0,
            f"pretraining.steps ({before.steps:,}) takes all of ppo.total_steps ({steps:,}): "
            "only pretraining.reward is learned from, not task.reward",
        )
    return said


class _Pace:
    """Steps a second since the first update."""

    def __init__(self, settings: PPOSettings, first: int) -> None:
        self._settings, self._first = settings, first
        self._warm = math.nan

    def progress(self, number: int, values: dict[str, float | None]) -> Progress:
        settings, now = self._settings, time.monotonic()
        done = number - 1 - self._first
        self._warm = self._warm if done else now
        rate = done * settings.samples / (now - self._warm) if done else math.nan
        total = settings.updates * settings.samples
        return Progress(number * settings.samples, total, rate, values)


def _policy(experiment: Experiment, seed: int, task: Task, learner: ppo.TrainState) -> Policy:
    actor, normaliser = jax.device_get((learner.parameters.actor, learner.normaliser))
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
    """Of the working tree that this package lies in, if it does."""
    try:
        found = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()
