"""The vector environment as Stable-Baselines3 has its own."""

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
def test_it_is_what_single_environments_would_be(limit):
    """Of hand-made scenarios: `test_vector` compares environments of ours."""

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
        for mine, its in zip(one[:3], other[:3], strict=True):
            assert mine.dtype == its.dtype
            np.testing.assert_allclose(mine, its, rtol=1e-6)
        for mine, its in zip(one[3], other[3], strict=True):
            assert mine.keys() == its.keys()
            for name in mine:
                np.testing.assert_allclose(mine[name], its[name], rtol=1e-6)
            ended += "terminal_observation" in mine
    assert ended > 4 * SCENARIOS


def counting(truncates=False, limit=None, scenarios=SCENARIOS):
    vector = VectorTaskEnvironment(Counting(truncates), scenarios, "SameStep", limit)
    return StableBaselines3Environment(vector)


def begun(environment, *lengths):
    """The first observations of a seed whose scenarios take so many cycles, in some order."""
    for seed in range(100):
        environment.seed(seed)
        seen = environment.reset()
        if sorted(length_of(seen[:, 0])) == list(lengths):
            return seen
    raise AssertionError("no such seed")


@pytest.mark.parametrize(
    ("truncates", "limit", "cut_after"),
    [
        (False, None, {}),
        (False, 3, {4: 3}),  # who ends in the limit's own step is not cut short
        (False, 2, {3: 2, 4: 2}),
        (False, 1, {2: 1, 3: 1, 4: 1}),
        (True, None, {2: 2, 3: 3, 4: 4}),
    ],
)
def test_only_scenarios_that_did_not_end_are_truncated(truncates, limit, cut_after):
    """With the last observation of the scenario that is over, and the first of the next one."""
    environment = counting(truncates, limit)
    seen = begun(environment, 2, 3, 4)
    drawn, lengths = seen[:, 0], length_of(seen[:, 0])
    actions, over = np.array([0, 1, 2]), np.zeros(SCENARIOS, dtype=bool)
    for cycle in range(1, 5):
        seen, rewards, done, infos = environment.step(actions)
        for number in np.flatnonzero(~over):
            length = min(lengths[number], limit or 4)
            info, told = infos[number], int(actions[number])
            assert rewards[number] == cycle + 10 * told
            assert done[number] == (cycle == length)
            assert info.pop("TimeLimit.truncated") == (cut_after.get(lengths[number]) == cycle)
            if not done[number]:
                assert info == {}
                np.testing.assert_allclose(
                    seen[number], [drawn[number], cycle / 100, cycle * told / 100], rtol=1e-6
                )
                continue
            np.testing.assert_allclose(
                info.pop("terminal_observation"),
                [drawn[number], cycle / 100, cycle * told / 100],
                rtol=1e-6,
            )
            assert seen[number, 1:].tolist() == [0.0, 0.0]
            assert seen[number, 0] != drawn[number]
            if limit and not truncates and lengths[number] > limit:
                assert info == {}  # nobody has judged it
            else:
                assert info["cycles"] == cycle
                assert info["instructions"] == cycle * told
                assert info["drawn"] == pytest.approx(drawn[number])
        over |= done
    assert over.all()


def test_a_seed_counts_for_one_reset():
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


def test_it_is_drawn():
    """Stable-Baselines3 puts two pictures one below the other."""
    vector = VectorTaskEnvironment(Visible(), 2, "SameStep", render_mode="rgb_array")
    drawn = StableBaselines3Environment(vector)
    begun(drawn, 2, 4)
    for _ in range(2):  # now one begins anew
        drawn.step(np.zeros(2, dtype=int))
    first, second = drawn.get_images()
    assert not np.array_equal(first, second)
    assert np.array_equal(drawn.render(), np.concatenate([first, second]))


def test_without_a_render_mode_there_is_no_picture():
    environment = counting()
    environment.reset()
    assert environment.get_images() == [None] * SCENARIOS


def test_a_wrong_environment_or_autoreset_mode_is_refused(types_unchecked):
    with pytest.raises(InputError, match=r"environment is a TaskEnvironment .allowed: Vector"):
        StableBaselines3Environment(TaskEnvironment(build_task(NavigationSettings("lateral"))))
    with pytest.raises(InputError, match=r"NextStep .allowed for Stable-Baselines3: SameStep"):
        StableBaselines3Environment(VectorTaskEnvironment(Counting(), 2))
