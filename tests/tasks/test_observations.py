"""Structured observations are flattened for networks and learned from like flat vectors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning import ppo
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import OneByOne
from skystack.tasks.conformance import check_task
from skystack.tasks.observations import flatten_observation
from skystack.tasks.plain import PlainTask
from tests.tasks.test_conformance import HalvingTask


class Structured(HalvingTask):
    """`HalvingTask`, which observes a number and its square, with a tree of two leaves."""

    def observe(self, state):
        flat = super().observe(state)
        return {"number": flat[:1], "others": (flat[1:],)}


def test_keeps_a_flat_observation_unchanged():
    for batch_axes, shape in ((0, (3,)), (1, (3, 5)), (2, (3, 5, 2))):
        values = jnp.arange(float(np.prod(shape))).reshape(shape)
        assert flatten_observation(values, batch_axes) is values


def test_concatenates_leaves_with_the_batch_axes_last():
    tree = {"a": jnp.arange(8.0).reshape(2, 2, 2), "b": jnp.asarray([9.0, 10.0])}
    flat = flatten_observation(tree, batch_axes=1)
    assert flat.tolist() == [[0, 1], [2, 3], [4, 5], [6, 7], [9, 10]]
    assert flatten_observation(jnp.asarray(3.0)[None]).tolist() == [3.0]


def test_a_scalar_becomes_one_value():
    assert flatten_observation((jnp.asarray(1.0), jnp.asarray([2.0, 3.0]))).tolist() == [1, 2, 3]


def test_a_task_can_observe_a_tree():
    check_task(Structured(), steps=3)
    plain = PlainTask(Structured())
    observation = plain.observe(plain.reset(jax.random.key(1)))
    assert observation.keys() == {"number", "others"}
    assert isinstance(observation["number"], np.ndarray)


@pytest.mark.slow
def test_learns_from_a_tree_as_from_the_flat_vector():
    settings = PPOSettings(environments=4, steps=8, minibatch=16, hidden=(4,), total_steps=64)
    weights = []
    for task in (HalvingTask(), Structured()):
        update = jax.jit(lambda state, task=task: ppo.update(OneByOne(task), settings, state))
        learned, _ = update(ppo.init(OneByOne(task), settings, jax.random.key(0)))
        weights.append(jax.device_get(learned.parameters))
    for flat, tree in zip(*map(jax.tree.leaves, weights), strict=True):
        np.testing.assert_allclose(flat, tree, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("task", [HalvingTask(), Structured()])
def test_gymnasium_observes_the_flat_vector(task):
    pytest.importorskip("gymnasium")
    from skystack.gym.environment import TaskEnvironment
    from skystack.gym.vector import VectorTaskEnvironment

    one, many = TaskEnvironment(task), VectorTaskEnvironment(OneByOne(task), 3)
    assert one.observation_space.shape == (2,)
    observation, _ = one.reset(seed=0)
    several, _ = many.reset(seed=0)
    assert several.shape == (3, 2)
    np.testing.assert_allclose(several[0], observation)
