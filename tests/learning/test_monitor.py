"""Non-finite or exploding values raise errors with the term, the step and the last checkpoint."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.errors import TrainingError
from skystack.learning.monitor import LOSSES, PARTS, TrainingMonitor

GOOD = dict.fromkeys(LOSSES, 1.0)


@pytest.fixture
def monitor():
    return TrainingMonitor("lateral", 3, Path("run/checkpoint/learner.safetensors"), 512)


def test_accepts_finite_values_and_infinities_in_scenarios(monitor, learner):
    assert any(
        np.isinf(np.asarray(leaf)).any()
        for leaf in jax.tree.leaves(learner.scenarios)
        if jnp.issubdtype(leaf.dtype, jnp.floating)
    )
    monitor.check(learner, GOOD, 768)


@pytest.mark.parametrize("term", LOSSES)
@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (None, "is not finite after 768 steps"),
        (1.1e6, "has exploded: 1.1e+06 (allowed: up to 1e+06"),
        (-3e20, "has exploded: -3e+20"),
    ],
)
def test_names_a_bad_loss(monitor, learner, term, value, problem):
    with pytest.raises(TrainingError) as raised:
        monitor.check(learner, GOOD | {term: value}, 768)
    message = str(raised.value)
    assert message.startswith(f"lateral, seed 3: {term} {problem}")
    assert message.endswith(
        "after 768 steps; last good checkpoint: run/checkpoint/learner.safetensors, after 512 steps"
    )


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_names_a_non_finite_part_of_the_learner(monitor, learner, part, value):
    original = getattr(learner, part)
    leaves, tree = jax.tree.flatten(original)
    damaged = [
        leaf.at[(0,) * leaf.ndim].set(value) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf
        for leaf in leaves
    ]
    bad = learner._replace(**{part: jax.tree.unflatten(tree, damaged)})
    with pytest.raises(TrainingError, match=f"non-finite value in the {part} after 768 steps"):
        monitor.check(bad, GOOD, 768)


def test_names_no_checkpoint_if_there_is_none(learner):
    monitor = TrainingMonitor("lateral", 0, Path("nowhere"), 0)
    with pytest.raises(TrainingError, match=r"last good checkpoint: none$"):
        monitor.check(learner, GOOD | {"entropy": None}, 256)


def test_names_the_first_of_several_bad_losses(monitor, learner):
    bad = dict.fromkeys(LOSSES)
    with pytest.raises(TrainingError, match="seed 3: policy_loss is not finite"):
        monitor.check(learner, bad, 768)
    with pytest.raises(TrainingError, match="seed 3: value_loss is not finite"):
        monitor.check(learner, bad | {"policy_loss": 1e6}, 768)
