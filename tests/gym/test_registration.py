"""Environments made from names, files and settings."""

import gymnasium
import pytest
from gymnasium.vector import AutoresetMode

import skystack.gym
from skystack.errors import InputError
from skystack.gym.registration import make_environment, make_vector_environment, settings_of
from skystack.learning.experiment import load_experiment
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from skystack.tasks.stacked_steps import StackedSteps

SHORT = NavigationSettings(cycles=7)


def test_settings_override_those_of_the_experiment():
    assert settings_of("vertical") == load_experiment("vertical").task
    assert settings_of("vertical", SHORT) is SHORT
    assert settings_of("no such experiment", SHORT) is SHORT
    with pytest.raises(InputError, match="unknown experiment"):
        settings_of("no such experiment")


def test_environments_with_equal_settings_share_programs():
    """Compiling takes seconds. An environment with other settings has its own programs."""
    first, second = (make_environment("lateral", NavigationSettings(cycles=7)) for _ in range(2))
    assert first.programs is second.programs
    assert first.task is second.task
    assert make_environment("lateral", NavigationSettings(cycles=8)).programs is not first.programs
    assert make_environment("vertical").task == build_task(load_experiment("vertical").task)


def test_options_are_passed_on():
    single = make_environment("lateral", SHORT, "rgb_array")
    assert single.render_mode == "rgb_array"
    default = make_vector_environment("lateral", settings=SHORT)
    assert (default.num_envs, default.max_episode_steps, default.render_mode) == (1, None, None)
    assert default.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    many = make_vector_environment("vertical", 3, SHORT, "Disabled", 5, "rgb_array")
    assert (many.num_envs, many.max_episode_steps, many.render_mode) == (3, 5, "rgb_array")
    assert many.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert many.task == default.task == single.task == build_task(SHORT)
    many.reset(seed=0)
    assert len(many.render()) == 3


def test_steps_are_those_of_training():
    assert isinstance(make_vector_environment("lateral-best").task, StackedSteps)
    assert isinstance(make_environment("lateral-best").task, StackedSteps)


@pytest.mark.parametrize("name", skystack.gym.REGISTERED)
def test_registered_environments_match_their_experiments(name):
    task = gymnasium.make(name).unwrapped.task
    assert task == build_task(load_experiment(skystack.gym.REGISTERED[name]).task)
