"""A training run: the loop round the compiled update, its files, progress and interruption."""

import hashlib
import json
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

from skystack.errors import InputError, TrainingError
from skystack.files import make_folder, write_aside
from skystack.learning import ppo
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.experiment import Experiment, resolved, to_toml
from skystack.learning.phases import compiled_updates, learners, phases
from skystack.learning.policy import (
    FORMAT,
    Policy,
    PolicyDescription,
    package_versions,
    save_policy,
)
from skystack.learning.settings import PPOSettings
from skystack.seeds import training_key
from skystack.tasks.build import build_training_task
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
    folder: Path,
    resume: bool = False,
    on_update: Callable[[Progress], None] = lambda progress: None,
) -> Trained:
    """Train one seed of an experiment into a folder.

    Writes `config.toml`, `metrics.jsonl` (a line an update), `checkpoint/` (once a minute and when
    interrupted) and, at the end, the policy. With `resume`, goes on from the checkpoint if there
    is one. Raises TrainingError when a loss is no number, InputError for a folder or checkpoint
    that cannot be used; on KeyboardInterrupt the checkpoint is written first.
    """
    begun = time.monotonic()
    task, settings = build_training_task(experiment.task), experiment.ppo
    checkpoint = make_folder(folder / "checkpoint") / CHECKPOINT
    fingerprint = hashlib.sha256(to_toml(experiment) + str(seed).encode()).hexdigest()
    init, key = jax.jit(partial(ppo.init, task, settings)), training_key(seed)
    like = jax.eval_shape(init, key)
    going_on = resume and checkpoint.exists()
    resumed = load_checkpoint(checkpoint, like, fingerprint) if going_on else None
    first = int(resumed.updates) if resumed else 0
    metrics = _Metrics(folder / "metrics.jsonl", first, begun)
    write_aside(folder / "config.toml", to_toml(experiment))
    compiled = compiled_updates(phases(experiment, task, first), settings, like)
    with closing(metrics), compiled as updates:
        learner = resumed or init(key)
        pace, saved = _Pace(settings, first), time.monotonic()
        try:
            for number, updated, measured in learners(updates, settings, learner):
                values = {name: _number(value) for name, value in jax.device_get(measured).items()}
                steps = number * settings.samples
                _check(values, experiment.name, seed, steps)
                metrics.append({"update": number, "steps": steps}, values)
                learner = updated  # after its line, which is cut off if it is to be written again
                on_update(pace.progress(number, values))
                if time.monotonic() - saved > CHECKPOINT_EVERY_S:
                    save_checkpoint(checkpoint, learner, fingerprint)
                    saved = time.monotonic()
        except KeyboardInterrupt:
            save_checkpoint(checkpoint, learner, fingerprint)
            raise
    save_checkpoint(checkpoint, learner, fingerprint)
    policy = _policy(experiment, seed, task, learner)
    save_policy(folder, policy)
    return Trained(policy, settings.updates * settings.samples, metrics.wall_s())


def begun_with(experiment: Experiment, folder: Path, resume: bool) -> list[str]:
    """What must be said before a training begins in a folder.

    Raises InputError where a finished training would be lost or nothing can be written.
    """
    make_folder(folder / "checkpoint")
    said = ["compiling ..."]
    if (folder / "policy.json").exists() and not resume:
        raise InputError(
            f"{folder}: holds a trained policy already (allowed: another folder by --out, or "
            "remove this one)"
        )
    if resume and not (folder / "checkpoint" / CHECKPOINT).exists():
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


class _Metrics:
    """`metrics.jsonl`, cut back to the lines of the updates already made."""

    def __init__(self, path: Path, updates: int, begun: float) -> None:
        lines = _lines(path, updates) if updates else []
        write_aside(path, "".join(lines).encode())
        # As if the updates made before had been made just before this run.
        self._begun: float = begun - (json.loads(lines[-1])["wall_s"] if lines else 0.0)
        self._file = path.open("a", encoding="utf-8")

    def wall_s(self) -> float:
        """What all has taken until now, earlier runs included as far as their lines tell."""
        return time.monotonic() - self._begun

    def append(self, line: dict[str, Any], values: dict[str, float | None]) -> None:
        self._file.write(json.dumps(line | {"wall_s": self.wall_s()} | values) + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def _lines(path: Path, updates: int) -> list[str]:
    """The lines of the first updates."""
    try:
        lines = path.read_text().splitlines(keepends=True)[:updates]
        if [json.loads(line)["update"] for line in lines] == list(range(1, updates + 1)):
            return lines
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise InputError(
        f"{path}: does not hold the {updates} updates of the checkpoint; "
        "train into another folder, or without --resume"
    )


def _check(values: dict[str, float | None], name: str, seed: int, steps: int) -> None:
    for term in ("policy_loss", "value_loss", "entropy"):
        if values[term] is None:
            raise TrainingError(f"{name}, seed {seed}: {term} is not finite after {steps} steps")


def _number(value: Any) -> float | None:
    """JSON has no NaN: what was not measured (no scenario ended) is null."""
    number = float(value)
    return number if math.isfinite(number) else None


def _policy(experiment: Experiment, seed: int, task: Task, learner: ppo.Learner) -> Policy:
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
