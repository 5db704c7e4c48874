"""What is not finite, or explodes, is named: the term, the step, the last good checkpoint."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.errors import TrainingError
from skystack.learning.monitor import LOSSES, PARTS, TrainingMonitor, finite

GOOD = dict.fromkeys(LOSSES, 1.0)


@pytest.fixture
def watch():
    return TrainingMonitor("lateral", 3, Path("run/checkpoint/learner.safetensors"), 512)


def test_good_numbers_pass_though_scenarios_hold_infinities(watch, learner):
    assert any(
        np.isinf(np.asarray(leaf)).any()
        for leaf in jax.tree.leaves(learner.scenarios)
        if jnp.issubdtype(leaf.dtype, jnp.floating)
    )
    watch.check(learner, GOOD, 768)


@pytest.mark.parametrize("term", LOSSES)
@pytest.mark.parametrize(
    ("value", "what"),
    [
        (None, "is not finite after 768 steps"),
        (1.1e6, "has exploded: 1.1e+06 (allowed: up to 1e+06"),
        (-3e20, "has exploded: -3e+20"),
    ],
)
def test_a_bad_loss_is_named(watch, learner, term, value, what):
    with pytest.raises(TrainingError) as raised:
        watch.check(learner, GOOD | {term: value}, 768)
    said = str(raised.value)
    assert said.startswith(f"lateral, seed 3: {term} {what}")
    assert said.endswith(
        "after 768 steps; last good checkpoint: run/checkpoint/learner.safetensors, after 512 steps"
    )


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_learner_that_is_not_finite_is_named(watch, learner, part, value):
    whole = getattr(learner, part)
    leaves, tree = jax.tree.flatten(whole)
    spoiled = [
        leaf.at[(0,) * leaf.ndim].set(value) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf
        for leaf in leaves
    ]
    bad = learner._replace(**{part: jax.tree.unflatten(tree, spoiled)})
    with pytest.raises(TrainingError, match=f"the learner's {part} are not finite after 768 steps"):
        watch.check(bad, GOOD, 768)


def test_without_a_checkpoint_none_is_named(learner):
    watch = TrainingMonitor("lateral", 0, Path("nowhere"), 0)
    with pytest.raises(TrainingError, match=r"last good checkpoint: none$"):
        watch.check(learner, GOOD | {"entropy": None}, 256)


def test_json_knows_no_infinite_numbers():
    assert (finite(1.5), finite(np.nan), finite(-np.inf)) == (1.5, None, None)


def test_the_first_of_several_bad_losses_is_named(watch, learner):
    bad = dict.fromkeys(LOSSES)
    with pytest.raises(TrainingError, match="seed 3: policy_loss is not finite"):
        watch.check(learner, bad, 768)
    with pytest.raises(TrainingError, match="seed 3: value_loss is not finite"):
        watch.check(learner, bad | {"policy_loss": 1e6}, 768)
