"""Copies and pickles of environments continue as the original does."""

import copy
import pickle
import warnings

import gymnasium
import jax
import msgspec
import numpy as np
import pytest

import skystack.gym  # noqa: F401  (registers)
from skystack.gym.registration import make_vector_environment
from skystack.gym.stacked import StackedEnvironment
from skystack.learning.seeds import scenario_key
from skystack.tasks.plain import PlainTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

SETTINGS = NavigationSettings(name="avoidance", aircraft=2, pair_features=("theta", "d"), cycles=12)
NAME = "skystack/Avoidance-v0"


def by_pickle(environment):
    return pickle.loads(pickle.dumps(environment))


def single(**options):
    return gymnasium.make(NAME, settings=SETTINGS, **options)


def stacked():
    return StackedEnvironment(single())


def vector():
    return make_vector_environment("avoidance", 3, SETTINGS, "SameStep")


def for_stable_baselines3():
    module = pytest.importorskip("skystack.gym.sb3")
    return module.StableBaselines3Environment(vector())


def for_pettingzoo():
    pytest.importorskip("pettingzoo")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from skystack.gym.multi_agent import parallel_env
    return parallel_env(settings=SETTINGS)


ONE, MANY = (lambda rng: int(rng.integers(5))), (lambda rng: rng.integers(5, size=3))


def agent_actions(rng):
    return {"AC1": int(rng.integers(3)), "AC2": int(rng.integers(3))}


KINDS = {
    single: ONE,
    stacked: ONE,
    vector: MANY,
    for_stable_baselines3: MANY,
    for_pettingzoo: agent_actions,
}
"""A maker of each class of environments, with a function that draws its actions."""


def check_identical(ours, theirs):
    def check(one, other):
        assert type(one) is type(other)
        # As lists, because arrays of objects contain arrays and None.
        np.testing.assert_equal(np.asarray(one).tolist(), np.asarray(other).tolist())

    jax.tree.map(check, ours, theirs)


def fly(environment, draw, steps):
    """Fly several scenarios, and return everything that the environment returned."""
    rng, returned = np.random.default_rng(1), []
    for _ in range(steps):
        returned.append(environment.step(draw(rng)))
        ended = returned[-1][2]
        if ended is True or (isinstance(ended, dict) and all(ended.values())):
            returned.append(environment.reset())
    return returned


def started(make):
    """An environment in the middle of its second scenario."""
    environment, draw = make(), KINDS[make]
    if hasattr(environment, "seed"):  # Stable-Baselines3
        environment.seed(3)
        environment.reset()
    else:
        environment.reset(seed=3)
    fly(environment, draw, SETTINGS.cycles + 4)
    return environment


@pytest.mark.slow
@pytest.mark.parametrize("by", [by_pickle, copy.deepcopy])
@pytest.mark.parametrize("make", KINDS)
def test_copy_in_mid_scenario_continues_identically(make, by):
    """Rewards, observations, ends and later scenarios; a copy and its original are independent."""
    environment = started(make)
    copied = by(environment)
    steps = 2 * SETTINGS.cycles + 5
    expected = fly(environment, KINDS[make], steps)
    second_copy = by(copied)
    for each in (copied, second_copy):
        check_identical(fly(each, KINDS[make], steps), expected)


@pytest.mark.parametrize("make", KINDS)
def test_copies_an_environment_before_its_first_reset(make):
    environment = make()
    for by in (by_pickle, copy.deepcopy, copy.copy):
        assert type(by(environment)) is type(environment)


@pytest.mark.slow
@pytest.mark.parametrize("by", [by_pickle, copy.deepcopy])
def test_copies_the_radar_picture_with_its_trail(by):
    environment = single(render_mode="rgb_array")
    environment.reset(seed=3)
    for _ in range(8):
        environment.step(1)
    copied = by(environment)
    assert np.array_equal(copied.render(), environment.render())
    environment.step(0)
    assert not np.array_equal(copied.render(), environment.render())
    copied.step(0)
    assert np.array_equal(copied.render(), environment.render())


def test_copied_task_equals_the_original():
    task = build_task(SETTINGS)
    plain = PlainTask(task)
    seen = plain.reset(scenario_key(0, 0))
    assert copy.deepcopy(plain) is plain
    unpickled, unpickled_state = by_pickle((plain, seen))
    assert unpickled.may_stack(unpickled_state, 1) == plain.may_stack(seen, 1)
    expected, outcome = plain.step(seen, 1)
    stepped, other = unpickled.step(unpickled_state, 1)
    check_identical((stepped, other), (expected, outcome))


def test_equal_tasks_share_their_programs():
    """Workers load many environments of one task; compiling each one would take seconds."""
    plain, same, unlike = (
        PlainTask(build_task(settings))
        for settings in (SETTINGS, SETTINGS, msgspec.structs.replace(SETTINGS, cycles=13))
    )
    tasks = [plain, same, by_pickle(plain), unlike]
    for each in tasks:
        each.reset(scenario_key(0, 0))
    programs = [each._programs["_reset"] for each in tasks]
    assert [each is programs[0] for each in programs] == [True, True, True, False]
