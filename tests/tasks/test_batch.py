"""A batch of scenarios gives the same results as its scenarios one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning.experiment import experiment_names, load_experiment
from skystack.tasks.batch import OneByOne, choose, reset_many
from skystack.tasks.registry import build_training_task

from .test_conformance import HalvingTask

SCENARIOS, STEPS = 12, 60


def fly(task, state, actions):
    def step(state, action):
        state, outcome = task.step(state, action)
        return state, (state, outcome, task.observe(state))

    return jax.lax.scan(step, state, actions)[1]


# Sector control has a test of its own.
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in experiment_names() if name != "sector-control"])
def test_a_batch_flies_like_its_scenarios_one_by_one(name):
    task = build_training_task(load_experiment(name).task)
    rng = np.random.default_rng(0)
    shape = (STEPS, SCENARIOS)
    chosen = rng.integers(0, len(task.action_names), shape) * (rng.random(shape) < 0.3)
    actions = jnp.asarray(chosen, dtype=jnp.int32)
    start = reset_many(task, jax.random.key(3), SCENARIOS)
    together = jax.jit(lambda s, a: fly(task, s, a))(start, actions)
    one_by_one = jax.jit(lambda s, a: fly(OneByOne(task), s, a))(start, actions)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(one_by_one), strict=True):
        assert a.shape == b.shape
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-4)


@pytest.mark.slow
def test_the_batch_axis_is_last():
    task = build_training_task(load_experiment("avoidance-best").task)
    state = reset_many(task, jax.random.key(0), SCENARIOS)
    assert {leaf.shape[-1] for leaf in jax.tree.leaves(state)} == {SCENARIOS}
    assert task.observe(state).shape == (len(task.observation_names), SCENARIOS)


def test_choose_selects_whole_scenarios():
    yes = (jnp.ones((2, 3)), jnp.ones(3))
    no = (jnp.zeros((2, 3)), jnp.zeros(3))
    matrix, vector = choose(jnp.array([True, False, True]), yes, no)
    assert matrix.tolist() == [[1, 0, 1]] * 2
    assert vector.tolist() == [1, 0, 1]


def test_one_by_one_runs_a_task_on_many_scenarios():
    """The results of each scenario are those of the task, with the batch axis last."""
    task, key = HalvingTask(), jax.random.key(2)
    many = OneByOne(task)
    alone = [task.reset(each) for each in jax.random.split(key, 3)]
    together = reset_many(task, key, 3)
    assert many.reset(key) == task.reset(key)

    def same(found, expected):
        rows = jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *expected)
        jax.tree.map(np.testing.assert_array_equal, found, rows)

    actions = jnp.asarray([0, 1, 1], dtype=jnp.int32)
    pairs = list(zip(alone, actions, strict=True))
    same(together, alone)
    same(many.observe(together), [task.observe(state) for state in alone])
    same(many.may_stack(together, actions), [task.may_stack(*pair) for pair in pairs])
    same(many.instruct(together, actions), [task.instruct(*pair) for pair in pairs])
    same(many.advance(together), [task.advance(state) for state in alone])
    same(many.step(together, actions), [task.step(*pair) for pair in pairs])
    assert (many.name, many.version) == ("number", 1)
    assert (many.action_names, many.observation_names) == (
        task.action_names,
        task.observation_names,
    )
