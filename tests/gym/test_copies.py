"""Copies and pickles of environments continue as the original does."""

import copy
import pickle
import warnings

import gymnasium
import jax
import numpy as np
import pytest

import skystack.gym  # noqa: F401  (registers)
from skystack.gym.registration import make_vector_environment
from skystack.gym.stacked import StackedEnvironment
from skystack.learning.seeds import scenario_key
from skystack.tasks import programs
from skystack.tasks.plain import PlainTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

SETTINGS = NavigationSettings(name="avoidance", aircraft=2, pair_features=("theta", "d"), cycles=12)
NAME = "skystack/Avoidance-v0"


def by_pickle(environment):
    return pickle.loads(pickle.dumps(environment))


def by_pickle_elsewhere(environment):
    """As in a process that does not hold the original: programs are compiled again."""
    dumped = pickle.dumps(environment)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(programs, "_ALIVE", type(programs._ALIVE)())
        return pickle.loads(dumped)


def made(**more):
    return gymnasium.make(NAME, settings=SETTINGS, **more)


def stacked():
    return StackedEnvironment(made())


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


def of_agents(rng):
    return {"AC1": int(rng.integers(3)), "AC2": int(rng.integers(3))}


KINDS = {
    made: ONE,
    stacked: ONE,
    vector: MANY,
    for_stable_baselines3: MANY,
    for_pettingzoo: of_agents,
}
"""Each class of environments, with what draws its actions."""


def check_identical(ours, theirs):
    def check(one, other):
        assert type(one) is type(other)
        # Lists, as arrays of objects hold arrays and None.
        np.testing.assert_equal(np.asarray(one).tolist(), np.asarray(other).tolist())

    jax.tree.map(check, ours, theirs)


def flown(environment, draw, steps):
    """Everything that comes back over several scenarios."""
    rng, back = np.random.default_rng(1), []
    for _ in range(steps):
        back.append(environment.step(draw(rng)))
        over = back[-1][2]
        if over is True or (isinstance(over, dict) and all(over.values())):
            back.append(environment.reset())
    return back


def begun(make):
    """An environment in the middle of its second scenario."""
    environment, draw = make(), KINDS[make]
    if hasattr(environment, "seed"):  # Stable-Baselines3
        environment.seed(3)
        environment.reset()
    else:
        environment.reset(seed=3)
    flown(environment, draw, SETTINGS.cycles + 4)
    return environment


@pytest.mark.parametrize("by", [by_pickle, by_pickle_elsewhere, copy.deepcopy])
@pytest.mark.parametrize("make", KINDS)
def test_a_copy_in_mid_scenario_continues_identically(make, by):
    """Rewards, observations, ends and the scenarios that follow; neither touches the other."""
    environment = begun(make)
    copied = by(environment)
    steps = 2 * SETTINGS.cycles + 5
    expected = flown(environment, KINDS[make], steps)
    again = by(copied)
    for each in (copied, again):
        check_identical(flown(each, KINDS[make], steps), expected)


@pytest.mark.parametrize("make", KINDS)
def test_what_has_not_begun_can_be_copied(make):
    environment = make()
    for by in (by_pickle, copy.deepcopy, copy.copy):
        assert type(by(environment)) is type(environment)


@pytest.mark.parametrize("by", [by_pickle, copy.deepcopy])
def test_the_radar_picture_is_copied_with_its_trail(by):
    drawn = made(render_mode="rgb_array")
    drawn.reset(seed=3)
    for _ in range(8):
        drawn.step(1)
    copied = by(drawn)
    assert np.array_equal(copied.render(), drawn.render())
    drawn.step(0)
    assert not np.array_equal(copied.render(), drawn.render())
    copied.step(0)
    assert np.array_equal(copied.render(), drawn.render())


def test_a_copied_task_is_the_task():
    task = build_task(SETTINGS)
    plain = PlainTask(task)
    seen = plain.reset(scenario_key(0, 0))
    assert by_pickle(plain) is plain
    assert copy.deepcopy(plain) is plain
    elsewhere, later = by_pickle_elsewhere((plain, seen))
    assert elsewhere is not plain
    assert elsewhere.may_stack(later, 1) == plain.may_stack(seen, 1)
    expected, outcome = plain.step(seen, 1)
    stepped, other = elsewhere.step(later, 1)
    check_identical((stepped, other), (expected, outcome))


def test_what_is_loaded_in_one_process_shares_its_programs():
    """Workers load many environments of one task; each compiled again would take seconds."""
    dumped = pickle.dumps(PlainTask(build_task(SETTINGS)))  # the original is gone
    first = pickle.loads(dumped)
    assert pickle.loads(dumped) is first
    assert PlainTask(build_task(SETTINGS)) is not first
