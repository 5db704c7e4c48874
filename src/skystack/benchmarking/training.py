"""How fast training is, and how soon a policy is good."""

import resource
from collections.abc import Iterator
from functools import partial

import jax

from skystack.benchmarking.figures import Figure, rates
from skystack.evaluation.rollout import fly, network_controller
from skystack.learning import ppo
from skystack.learning.experiment import Experiment, load_experiment
from skystack.learning.run import phases
from skystack.programs import compile_for_one_core
from skystack.seeds import training_key
from skystack.tasks.build import build_task, build_training_task

STEPS = 150_000
"""At least so many steps a repetition."""
SUCCESS, SCENARIOS = 0.95, 200
CHECKED_EVERY = 20
"""Updates."""


def training_figures(experiment: str, repetitions: int) -> list[Figure]:
    """Steps a second of an experiment's second phase, compilation not counted, and the memory."""
    compile_for_one_core()
    chosen = load_experiment(experiment)
    settings, task = chosen.ppo, build_training_task(chosen.task)
    learner = jax.jit(partial(ppo.init, task, settings))(training_key(0))
    update = jax.jit(partial(ppo.update, task, settings))
    updates = -(-STEPS // settings.samples)

    def run() -> None:
        nonlocal learner
        for _ in range(updates):
            learner, measured = update(learner)
            jax.device_get(measured)

    found = rates(run, updates * settings.samples, repetitions)
    how = (
        f"settings of `{experiment}`: {settings.environments} environments, {settings.steps} steps,"
        f" {settings.epochs} epochs, minibatches of {settings.minibatch}; one process"
    )
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return [
        Figure(f"training, {experiment}", "steps/s", found, how),
        Figure(f"memory while training, {experiment}", "MB", (megabytes,), "peak, whole process"),
    ]


def reaches_success(experiment: str, seed: int) -> bool:
    """Train until success on held-out scenarios reaches `SUCCESS`, stacked; False if never."""
    compile_for_one_core()
    chosen = load_experiment(experiment)
    task = build_task(chosen.task)
    for learner in _trained(chosen, seed):
        controller = network_controller(learner.parameters.actor, learner.normaliser, greedy=True)
        flown = fly(task, controller, seed=0, scenarios=SCENARIOS, stacking=True)
        if float(flown.metrics.success.mean()) >= SUCCESS:
            return True
    return False


def _trained(experiment: Experiment, seed: int) -> Iterator[ppo.Learner]:
    """The learner every so many updates."""
    settings, task = experiment.ppo, build_training_task(experiment.task)
    learner = jax.jit(partial(ppo.init, task, settings))(training_key(seed))
    tasks = phases(experiment, task, first=0)
    for number in range(settings.updates):
        if number in tasks:
            phase = partial(ppo.update, tasks[number], settings)
            update = jax.jit(phase)
        learner, _ = update(learner)
        if (number + 1) % CHECKED_EVERY == 0:
            yield learner
