"""The plain PPO that training is compared with learns, too."""

from functools import partial

import jax
import jax.numpy as jnp
import pytest

from skystack.benchmarking import plain_ppo
from skystack.learning.inference import forward
from skystack.learning.settings import PPOSettings
from tests.learning.test_ppo import SignTask


@pytest.mark.slow
def test_learns_a_task_with_a_known_answer():
    settings = PPOSettings(
        learning_rate=3e-3, environments=16, steps=32, minibatch=64, epochs=4, reward_scale=1.0
    )
    task = SignTask()
    carry = plain_ppo.start(task, settings, jax.random.key(0))
    update = jax.jit(partial(plain_ppo.update, task, settings))
    for _ in range(40):
        carry, loss = update(carry)
        assert bool(jnp.all(jnp.isfinite(loss)))
    observations = jnp.linspace(0.0, 1.0, 101)[:, None]
    actions = jnp.argmax(forward(carry.parameters.actor, plain_ppo._centred(observations)), axis=1)
    assert float(jnp.mean((actions == 1) == (observations[:, 0] > 0.5))) > 0.9
