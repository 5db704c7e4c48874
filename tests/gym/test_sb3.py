"""The vector environment as Stable-Baselines3 has its own."""

import numpy as np
import pytest

from skystack.errors import InputError
from skystack.gym.registration import make_environment, make_vector_environment
from skystack.tasks.settings import TaskSettings

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.vec_env import DummyVecEnv

from skystack.gym.sb3 import StableBaselines3Environment

SETTINGS = TaskSettings(cycles=25)
SCENARIOS = 3


@pytest.fixture(scope="module")
def ours():
    return StableBaselines3Environment(
        make_vector_environment("lateral", SCENARIOS, SETTINGS, "SameStep")
    )


def test_it_is_what_single_environments_would_be(ours):
    theirs = DummyVecEnv([lambda: make_environment("lateral", SETTINGS)] * SCENARIOS)
    both = (ours, theirs)
    for environment in both:
        environment.seed(3)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), atol=1e-6)
    rng, ended = np.random.default_rng(0), 0
    for _ in range(2 * SETTINGS.cycles + 5):
        actions = rng.integers(5, size=SCENARIOS)
        one, other = (environment.step(actions) for environment in both)
        for mine, its in zip(one[:3], other[:3], strict=True):
            assert mine.dtype == its.dtype
            np.testing.assert_allclose(mine, its, atol=1e-4)
        for mine, its in zip(one[3], other[3], strict=True):
            assert mine.keys() == its.keys()
            for name in mine:
                np.testing.assert_allclose(mine[name], its[name], atol=1e-3)
            ended += "terminal_observation" in mine
    assert ended == 2 * SCENARIOS
    assert ours.env_is_wrapped(object, 1) == [False]
    assert ours.get_attr("num_envs", [0, 2]) == [SCENARIOS] * 2


def test_it_is_drawn():
    """Stable-Baselines3 puts two pictures one below the other."""
    vector = make_vector_environment("lateral", 2, SETTINGS, "SameStep", render_mode="rgb_array")
    drawn = StableBaselines3Environment(vector)
    drawn.seed(0)
    drawn.reset()
    first, second = drawn.get_images()
    assert np.array_equal(drawn.render(), np.concatenate([first, second]))
    assert not np.array_equal(first, second)


def test_without_a_render_mode_there_is_no_picture(ours):
    assert ours.get_images() == [None] * SCENARIOS


def test_another_autoreset_mode_is_refused():
    with pytest.raises(InputError, match=r"NextStep .allowed for Stable-Baselines3: SameStep"):
        StableBaselines3Environment(make_vector_environment("lateral"))
