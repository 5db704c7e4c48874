"""Timed trainings are real trainings, and their figures describe them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.benchmarking import training
from skystack.learning import ppo
from skystack.learning.experiment import load_experiment
from skystack.learning.seeds import training_key
from skystack.tasks.registry import build_training_task

SMALL = ("ppo.environments=4", "ppo.steps=8", "ppo.minibatch=16", "ppo.epochs=2")


@pytest.fixture
def small(monkeypatch):
    experiment = load_experiment("lateral", SMALL)
    monkeypatch.setattr(training, "load_experiment", lambda name: experiment)
    monkeypatch.setattr(training, "STEPS", 1)
    return experiment


@pytest.mark.slow
def test_seeds_trained_together_learn_the_same_as_alone(small):
    task, settings = build_training_task(small.task), small.ppo
    init, update = jax.jit(partial(ppo.init, task, settings)), partial(ppo.update, task, settings)
    states = [init(training_key(seed)) for seed in range(2)]
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    together, _ = jax.jit(jax.vmap(update))(both)
    for seed, learner in enumerate(states):
        alone, _ = jax.jit(update)(learner)
        for ours, theirs in zip(
            jax.tree.leaves(together.parameters), jax.tree.leaves(alone.parameters), strict=True
        ):
            np.testing.assert_allclose(ours[seed], theirs, atol=2e-5)


@pytest.mark.slow
def test_figures_describe_the_training(small):
    rate, memory = training.training_figures("lateral", 2, seeds=2)
    assert (rate.name, rate.unit, len(rate.values)) == (
        "training, lateral, 2 seeds at once",
        "steps/s",
        2,
    )
    assert "4 environments, 8 steps, 2 epochs, minibatches of 16" in rate.configuration
    assert jax.devices()[0].device_kind in rate.configuration
    assert memory.values[0] > 50.0


def test_accelerator_figures_are_empty_on_a_cpu():
    assert jax.default_backend() == "cpu"
    assert training.accelerator_figures("lateral", 1) == []
