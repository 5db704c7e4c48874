"""The vector environment with the interface of Stable-Baselines3."""

import gymnasium
import numpy as np
import pytest

from skystack.errors import InputError
from skystack.gym.environment import TaskEnvironment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from tests.gym.counting import Counting, Visible, length_of

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.vec_env import DummyVecEnv

from skystack.gym.sb3 import StableBaselines3Environment

SCENARIOS = 3


@pytest.mark.parametrize("limit", [None, 3])
def test_agrees_with_single_environments(limit):
    """With the counting task; `test_vector` compares environments with skystack's tasks."""

    def single():
        return gymnasium.wrappers.TimeLimit(TaskEnvironment(Counting()), limit or 99)

    ours, theirs = counting(limit=limit), DummyVecEnv([single] * SCENARIOS)
    for environment in (ours, theirs):
        environment.seed(3)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng, ended = np.random.default_rng(0), 0
    for _ in range(20):
        actions = rng.integers(3, size=SCENARIOS)
        one, other = (environment.step(actions) for environment in (ours, theirs))
        for found, expected in zip(one[:3], other[:3], strict=True):
            assert found.dtype == expected.dtype
            np.testing.assert_allclose(found, expected, rtol=1e-6)
        for found, expected in zip(one[3], other[3], strict=True):
            assert found.keys() == expected.keys()
            for name in found:
                np.testing.assert_allclose(found[name], expected[name], rtol=1e-6)
            ended += "terminal_observation" in found
    assert ended > 4 * SCENARIOS


def counting(truncates=False, limit=None, scenarios=SCENARIOS):
    vector = VectorTaskEnvironment(Counting(truncates), scenarios, "SameStep", limit)
    return StableBaselines3Environment(vector)


def reset_to_lengths(environment, *lengths):
    """Reset with a seed whose scenarios have these lengths, in any order; first observations."""
    for seed in range(100):
        environment.seed(seed)
        seen = environment.reset()
        if sorted(length_of(seen[:, 0])) == list(lengths):
            return seen
    raise AssertionError("no such seed")


@pytest.mark.parametrize(
    ("truncates", "limit", "truncated_after"),
    [
        (False, None, {}),
        (False, 3, {4: 3}),  # ending at the limit is not truncation
        (False, 2, {3: 2, 4: 2}),
        (False, 1, {2: 1, 3: 1, 4: 1}),
        (True, None, {2: 2, 3: 3, 4: 4}),
    ],
)
def test_only_scenarios_that_did_not_end_are_truncated(truncates, limit, truncated_after):
    """The terminal observation is the last of the old scenario; a new scenario follows."""
    environment = counting(truncates, limit)
    seen = reset_to_lengths(environment, 2, 3, 4)
    drawn, lengths = seen[:, 0], length_of(seen[:, 0])
    actions, ended = np.array([0, 1, 2]), np.zeros(SCENARIOS, dtype=bool)
    for cycle in range(1, 5):
        seen, rewards, done, infos = environment.step(actions)
        for number in np.flatnonzero(~ended):
            length = min(lengths[number], limit or 4)
            info, action = infos[number], int(actions[number])
            assert rewards[number] == cycle + 10 * action
            assert done[number] == (cycle == length)
            assert info.pop("TimeLimit.truncated") == (
                truncated_after.get(lengths[number]) == cycle
            )
            if not done[number]:
                assert info == {}
                np.testing.assert_allclose(
                    seen[number], [drawn[number], cycle / 100, cycle * action / 100], rtol=1e-6
                )
                continue
            np.testing.assert_allclose(
                info.pop("terminal_observation"),
                [drawn[number], cycle / 100, cycle * action / 100],
                rtol=1e-6,
            )
            assert seen[number, 1:].tolist() == [0.0, 0.0]
            assert seen[number, 0] != drawn[number]
            if limit and not truncates and lengths[number] > limit:
                assert info == {}  # no metrics: the task has not ended it
            else:
                assert info["cycles"] == cycle
                assert info["instructions"] == cycle * action
                assert info["drawn"] == pytest.approx(drawn[number])
        ended |= done
    assert ended.all()


def test_seed_applies_to_one_reset():
    environment = counting()
    environment.seed(5)
    first, second = environment.reset(), environment.reset()
    assert not np.array_equal(first, second)
    environment.seed(5)
    assert np.array_equal(environment.reset(), first)
    assert np.array_equal(environment.reset(), second)


def test_attributes_come_from_the_requested_scenarios():
    environment = counting()
    assert environment.get_attr("num_envs") == [3, 3, 3]
    assert environment.get_attr("num_envs", 1) == [3]
    assert environment.env_is_wrapped(object) == [False] * 3
    assert environment.env_is_wrapped(object, [0, 2]) == [False] * 2
    for change in (
        lambda: environment.set_attr("num_envs", 2),
        lambda: environment.env_method("render"),
    ):
        with pytest.raises(NotImplementedError, match="scenarios of a vector environment have no"):
            change()


def test_renders_all_scenarios():
    """Stable-Baselines3 tiles two pictures vertically."""
    vector = VectorTaskEnvironment(Visible(), 2, "SameStep", render_mode="rgb_array")
    environment = StableBaselines3Environment(vector)
    reset_to_lengths(environment, 2, 4)
    for _ in range(2):  # then one scenario has restarted
        environment.step(np.zeros(2, dtype=int))
    first, second = environment.get_images()
    assert not np.array_equal(first, second)
    assert np.array_equal(environment.render(), np.concatenate([first, second]))


def test_no_pictures_without_a_render_mode():
    environment = counting()
    environment.reset()
    assert environment.get_images() == [None] * SCENARIOS


def test_rejects_a_wrong_environment_or_autoreset_mode(types_unchecked):
    with pytest.raises(InputError, match=r"environment is a TaskEnvironment .allowed: Vector"):
        StableBaselines3Environment(TaskEnvironment(build_task(NavigationSettings("lateral"))))
    with pytest.raises(InputError, match=r"NextStep .allowed for Stable-Baselines3: SameStep"):
        StableBaselines3Environment(VectorTaskEnvironment(Counting(), 2))
