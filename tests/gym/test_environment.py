"""A task as a Gymnasium environment."""

import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from skystack.gym.environment import TaskEnvironment
from skystack.learning.experiment import load_experiment
from skystack.tasks.build import build_task


@pytest.fixture(scope="module")
def environment():
    return TaskEnvironment(build_task(load_experiment("avoidance").task))


def test_gymnasium_has_nothing_to_complain_about(environment):
    check_env(environment, skip_render_check=True)


def test_a_seed_gives_the_same_scenarios_in_the_same_order(environment):
    first = [environment.reset(seed=5)[0], *(environment.reset()[0] for _ in range(3))]
    again = [environment.reset(seed=5)[0], *(environment.reset()[0] for _ in range(3))]
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(environment.reset(seed=6)[0], first[0])


def test_a_scenario_goes_as_in_the_task(environment):
    """Rewards, observations and end of the task's own steps; metrics only at the end."""
    task = environment.task
    environment.reset(seed=1)
    state = environment._state
    step, observe = jax.jit(task.step), jax.jit(task.observe)
    rng = np.random.default_rng(0)
    for cycle in range(task.settings.cycles):
        action = rng.integers(len(task.action_names)) if cycle < 20 else np.int64(0)
        seen, reward, terminated, truncated, info = environment.step(action)
        state, outcome = step(state, np.int32(action))
        assert np.array_equal(seen, observe(state))
        assert (reward, terminated, truncated) == (outcome.reward, outcome.terminated, False)
        if terminated:
            break
        assert info == {}
    assert terminated
    assert info == {key: value.item() for key, value in outcome.metrics._asdict().items()}
