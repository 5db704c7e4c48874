"""A minimal, untrained `TrainState`."""

import jax
import pytest

from skystack.learning import ppo
from skystack.learning.settings import PPOSettings
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings


@pytest.fixture(scope="module")
def learner():
    settings = PPOSettings(environments=2, hidden=(4,))
    init = jax.jit(lambda key: ppo.init(build_task(NavigationSettings()), settings, key))
    return init(jax.random.key(0))
