"""The speed of training, and the time until a policy is good."""

import resource
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from skystack.benchmarking.figures import Figure, rates
from skystack.compilation.programs import compile_for_cores
from skystack.evaluation.rollout import concatenate, prepare
from skystack.learning import ppo
from skystack.learning.choices import most_probable
from skystack.learning.experiment import load_experiment
from skystack.learning.phases import compiled_updates, phases, run_updates
from skystack.learning.seeds import training_key
from skystack.tasks.registry import build_traffic_task, build_training_task

STEPS = 150_000
"""The least number of steps per repetition."""
SUCCESS, SCENARIOS = 0.95, 200
CHECKED_EVERY = 10
"""The number of updates between two evaluations."""
SEEDS_AT_ONCE = 32
PEAK = "peak of the whole process, without the memory of a GPU"


def training_figures(experiment: str, repetitions: int, seeds: int = 1) -> list[Figure]:
    """Steps per second in an experiment's second phase, without compilation, and the memory.

    Several seeds are trained at once by one program, and their steps are added up.
    """
    compile_for_cores(1)
    chosen = load_experiment(experiment)
    settings, task = chosen.ppo, build_training_task(chosen.task)
    init = jax.jit(partial(ppo.init, task, settings))
    update: Callable[..., Any] = partial(ppo.update, task, settings)
    learner = init(training_key(0))
    if seeds > 1:
        # Initialised one by one: many QR decompositions at once can deadlock.
        each = [init(training_key(seed)) for seed in range(seeds)]
        learner, update = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each), jax.vmap(update)
    compiled = jax.jit(update)
    updates = -(-STEPS // settings.samples)

    def run() -> None:
        nonlocal learner
        for _ in range(updates):
            learner, measured = compiled(learner)
            jax.device_get(measured)

    speeds = rates(run, updates * settings.samples * seeds, repetitions)
    setup = (
        f"settings of `{experiment}`: {settings.environments} environments, {settings.steps} steps,"
        f" {settings.epochs} epochs, minibatches of {settings.minibatch}; one process, on "
        f"{jax.devices()[0].device_kind}"
    )
    name = f"training, {experiment}" + f", {seeds} seeds at once" * (seeds > 1)
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return [
        Figure(name, "steps/s", speeds, setup),
        Figure(name.replace("training", "memory while training"), "MB", (megabytes,), PEAK),
    ]


def accelerator_figures(experiment: str, repetitions: int) -> list[Figure]:
    """The figures of many seeds at once on a GPU; none without a GPU."""
    if jax.default_backend() == "cpu":
        return []
    return training_figures(experiment, repetitions, SEEDS_AT_ONCE)


def reaches_success(experiment: str, seed: int) -> bool:
    """Train until the stacked success on held-out scenarios is `SUCCESS`; False if it never is."""
    compile_for_cores(1)
    chosen = load_experiment(experiment)
    settings, task = chosen.ppo, build_training_task(chosen.task)
    init, key = jax.jit(partial(ppo.init, task, settings)), training_key(seed)
    fly = prepare(build_traffic_task(chosen.task), most_probable, stacking=True)
    compiled = compiled_updates(phases(chosen, task, first=0), settings, jax.eval_shape(init, key))
    with compiled as updates:
        for number, learner, _ in run_updates(updates, settings, init(key)):
            if number % CHECKED_EVERY == 0:
                weights = (learner.parameters.actor, learner.normaliser)
                recording = concatenate(list(fly(weights, 0, SCENARIOS)))
                if float(recording.metrics["success"].mean()) >= SUCCESS:
                    return True
    return False
