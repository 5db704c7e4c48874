"""Each aircraft an agent: PettingZoo's own tests, and the single environment as the other path."""

import warnings

import numpy as np
import pytest

from skystack.errors import InputError
from skystack.gym.registration import make_environment
from skystack.tasks.settings import TaskSettings

pettingzoo = pytest.importorskip("pettingzoo")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its tests import what they do not need
    from pettingzoo.test import parallel_api_test, parallel_seed_test

from skystack.gym.multi_agent import MultiAgentEnvironment, parallel_env  # noqa: E402

SETTINGS = TaskSettings(name="avoidance", aircraft=2, pair_features=("theta", "d"), cycles=60)
AC1, AC2 = "AC1", "AC2"


@pytest.fixture(scope="module")
def environment():
    return parallel_env(settings=SETTINGS)


@pytest.fixture(scope="module")
def single():
    return make_environment("avoidance", SETTINGS)


def test_pettingzoo_has_nothing_to_complain_about(environment):
    parallel_api_test(environment, num_cycles=100)


def test_a_seed_decides_everything(environment):
    other = MultiAgentEnvironment(environment.task)
    other._programs = environment._programs
    both = iter((environment, other))
    parallel_seed_test(lambda: next(both), num_cycles=30)


def test_one_agent_that_speaks_is_the_single_environment(environment, single):
    """What AC1 sees, the reward, the end and the metrics; the actions of AC2 come behind AC1's."""
    seen, _ = environment.reset(seed=4)
    expected, _ = single.reset(seed=4)
    assert np.array_equal(environment.state(), expected)
    rng, over = np.random.default_rng(0), False
    while not over:
        agent, action = str(rng.choice([AC1, AC2])), int(rng.integers(3))
        told = action + 2 if agent == AC2 and action else action
        expected, reward, over, _, info = single.step(told)
        seen, rewards, terminated, truncated, infos = environment.step({agent: action})
        np.testing.assert_allclose(seen[AC1], expected, atol=1e-5)
        assert rewards == {AC1: pytest.approx(reward, abs=1e-5), AC2: rewards[AC1]}
        assert terminated == {AC1: over, AC2: over}
        assert truncated == {AC1: False, AC2: False}
    assert infos == {AC1: pytest.approx(info, abs=1e-3), AC2: infos[AC1]}
    assert environment.agents == []


def test_every_agent_sees_itself_first(environment):
    """Own four values and the other's change places; the distance between them stays."""
    environment.reset(seed=4)
    seen, *_ = environment.step({AC1: 1, AC2: 2})
    first, second = seen[AC1], seen[AC2]
    assert np.array_equal(first[:4], second[4:8])
    assert np.array_equal(first[4:8], second[:4])
    assert first[9] == pytest.approx(second[9], abs=1e-6)
    turns = [360.0 * value - 180.0 for value in (first[8], second[8])]
    headings = environment._now.traffic.cleared_heading_deg
    # Bearings from each to the other are opposite.
    assert (turns[0] + headings[0] - turns[1] - headings[1]) % 360.0 == pytest.approx(180, abs=0.1)


def test_all_instruct_in_one_cycle(environment):
    environment.reset(seed=4)
    before = np.asarray(environment._now.traffic.cleared_heading_deg)
    environment.step({AC1: 1, AC2: 2})
    memory = environment._now.memory
    cleared = np.asarray(environment._now.traffic.cleared_heading_deg)
    change = (cleared - np.round(before) + 180.0) % 360.0 - 180.0
    assert change.tolist() == pytest.approx([-10.0, 10.0], abs=0.51)
    assert memory.instructions.tolist() == [1.0, 1.0]
    assert memory.cycles == 1.0


def test_what_does_not_exist_is_refused(environment):
    environment.reset(seed=0)
    with pytest.raises(InputError, match="unknown agent 'AC3'"):
        environment.step({"AC3": 0})
    with pytest.raises(InputError, match="allowed: whole numbers from 0 to 2"):
        environment.step({AC1: 3})


def test_it_is_drawn(environment):
    drawn = MultiAgentEnvironment(environment.task, "rgb_array")
    drawn._programs = environment._programs
    drawn.reset(seed=0)
    begun = drawn.render()
    drawn.step({AC1: 2})
    assert begun.ndim == 3
    assert not np.array_equal(drawn.render(), begun)
