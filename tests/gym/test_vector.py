"""Many scenarios in one program are what Gymnasium makes of single environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import skystack.gym  # noqa: F401  (registers)
from skystack.errors import InputError
from skystack.gym.registration import make_environment, make_vector_environment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.learning.experiment import load_experiment
from skystack.tasks.build import build_task
from skystack.tasks.stacked_steps import StackedSteps

SCENARIOS, STEPS = 3, 300
NAME = "skystack/Avoidance-v0"


@pytest.fixture(scope="module")
def task():
    return build_task(load_experiment("avoidance").task)


def single():
    return make_environment("avoidance")


@pytest.fixture(scope="module")
def vector(task):
    """Environments that share their compiled programs."""
    first = VectorTaskEnvironment(task, SCENARIOS)

    def another(*options, **more):
        environment = VectorTaskEnvironment(task, SCENARIOS, *options, **more)
        for program in ("_begun", "_stepped", "_restarted"):
            setattr(environment, program, getattr(first, program))
        return environment

    return another


def alike(ours, theirs):
    """Equal, numbers up to rounding: two programs may round differently."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for key in ours:
            alike(ours[key], theirs[key])
    elif ours.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            if one is not None or other is not None:
                alike(one, other)
    else:
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=2e-4)


def check_the_same(ours, theirs, seed, steps):
    """Fly both with the same actions; returns how many scenarios ended."""
    for one, other in zip(ours.reset(seed=seed), theirs.reset(seed=seed), strict=True):
        alike(one, other)
    assert ours.np_random_seed == theirs.np_random_seed
    rng, ended = np.random.default_rng(0), 0
    for _ in range(steps):
        actions = rng.integers(5, size=SCENARIOS) * (rng.random(SCENARIOS) < 0.2)
        for one, other in zip(ours.step(actions), theirs.step(actions), strict=True):
            alike(one, other)
        ended += int(ours._over.sum())
    return ended


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("seed", [7, [3, 1, 4]])
def test_it_is_the_synchronous_vector_environment(vector, mode, seed):
    """Through scenarios that end by themselves, and those that follow them."""
    theirs = SyncVectorEnv([single] * SCENARIOS, autoreset_mode=mode)
    ours = vector(mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert check_the_same(ours, theirs, seed, STEPS) >= SCENARIOS


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_time_limit_truncates_as_gymnasiums_does(vector, mode):
    limited = [lambda: gymnasium.wrappers.TimeLimit(single(), 9)] * SCENARIOS
    theirs = SyncVectorEnv(limited, autoreset_mode=mode)
    ours = vector(mode, max_episode_steps=9)
    assert check_the_same(ours, theirs, 0, 30) == 3 * SCENARIOS


def test_after_a_reset_without_a_seed_new_scenarios_follow(vector):
    environment = vector()
    first, _ = environment.reset(seed=0)
    second, _ = environment.reset()
    assert not np.array_equal(first, second)
    environment.reset(seed=0)
    assert np.array_equal(environment.reset()[0], second)


def test_gymnasium_makes_it():
    made = gymnasium.make_vec(NAME, num_envs=4, autoreset_mode="SameStep")
    assert isinstance(made, VectorTaskEnvironment)
    assert made.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert made.reset(seed=0)[0] in made.observation_space


@pytest.mark.parametrize("actions", [[0, 0], [0, 0, 5], [0, 0, -1], [0.0, 0.0, 0.0]])
def test_actions_that_are_not_in_the_table_are_refused(vector, actions):
    environment = vector()
    environment.reset(seed=0)
    with pytest.raises(InputError, match="allowed: 3 whole numbers from 0 to 4"):
        environment.step(np.array(actions))


def test_what_cannot_be_is_refused(task, vector):
    with pytest.raises(InputError, match="allowed: NextStep, SameStep"):
        VectorTaskEnvironment(task, SCENARIOS, "Disabled")
    with pytest.raises(InputError, match="max_episode_steps is 0"):
        VectorTaskEnvironment(task, SCENARIOS, max_episode_steps=0)
    with pytest.raises(InputError, match="num_envs is 0"):
        make_vector_environment("lateral", 0)
    with pytest.raises(InputError, match=r"a list of 2 \(allowed: 3\)"):
        vector().reset(seed=[1, 2])
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector().step(np.zeros(SCENARIOS, dtype=int))


def test_steps_are_those_of_the_trainer():
    assert isinstance(make_vector_environment("lateral-best").task, StackedSteps)
    assert isinstance(make_environment("lateral-best").task, StackedSteps)
