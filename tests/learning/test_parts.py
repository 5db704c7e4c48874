"""Updates in parts: the same result as the whole update."""

from functools import partial

import jax
import numpy as np
import pytest

from skystack.learning import ppo
from skystack.learning.parts import compile_update, cores_for
from skystack.learning.settings import PPOSettings
from tests.learning.test_ppo import SignTask
from tests.learning.test_ppo_many import TellSigns

SETTINGS = PPOSettings(environments=512, steps=4, epochs=2, minibatch=256, hidden=(8,))
"""Every part has more agents than are computed at once."""


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_update_in_parts_is_bit_identical(count):
    task, key = TellSigns(), jax.random.key(0)
    whole = together = jax.jit(partial(ppo.init, task, SETTINGS))(key)
    update = jax.jit(partial(ppo.update, task, SETTINGS))
    in_parts = compile_update(task, SETTINGS, jax.eval_shape(lambda: whole), count)
    for _ in range(3):
        whole, expected = update(whole)
        together, measured = in_parts(together)
        np.testing.assert_equal(measured, expected)
    assert int(together.updates) == 3
    assert jax.random.key_data(together.key).tolist() == jax.random.key_data(whole.key).tolist()
    states = (each._replace(key=None) for each in (together, whole))
    for ours, theirs in zip(*map(jax.tree.leaves, states), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_only_tasks_with_several_agents_are_trained_on_several_cores():
    assert (cores_for(TellSigns()), cores_for(SignTask())) == (2, 1)


@pytest.mark.slow
def test_an_odd_number_of_environments_is_collected_whole():
    settings = PPOSettings(environments=3, steps=4, epochs=1, minibatch=8, hidden=(4,))
    task = TellSigns()
    train_state = ppo.init(task, settings, jax.random.key(0))
    after, _ = compile_update(task, settings, train_state)(train_state)
    assert int(after.updates) == 1
