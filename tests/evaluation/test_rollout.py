"""Scenarios are flown under their own keys: alone or among others, in whatever loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.agents.agent import Agent
from skystack.errors import InputError
from skystack.evaluation import rollout
from skystack.evaluation.hosted import HostedController, fly_hosted
from skystack.evaluation.platform_rollout import Pilot, PlatformRollout
from skystack.evaluation.rollout import Controller, concatenate, prepare, recording_of
from skystack.learning.seeds import scenario_key
from skystack.tasks.contract import AircraftStatus
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

from .faulty import open_own
from .recordings import metrics, traffic

SEED, SCENARIOS = 3, 4
TASK = build_task(NavigationSettings(cycles=12))
ACTIONS = len(TASK.action_names)


def by_chance(weights, seen, key):
    """Every action is as probable as any other."""
    return jax.random.categorical(key, jnp.zeros(ACTIONS))


def drawn(recording):
    return np.stack([recording.action, recording.instructions], axis=-1)


@pytest.fixture(scope="module", autouse=True)
def two_at_once():
    """So that four are flown in parts, as thousands are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollout, "SCENARIOS_AT_ONCE", 2)
        yield


@pytest.fixture(scope="module")
def flying():
    fly = prepare(TASK, by_chance, stacking=True)
    return lambda *how: concatenate(list(fly(*how)))


@pytest.fixture(scope="module")
def flown(flying):
    return flying((), SEED, SCENARIOS)


def test_every_scenario_is_flown_once_from_where_its_own_key_draws_it(flown):
    assert flown.number.tolist() == list(range(SCENARIOS))
    for number in range(SCENARIOS):
        start = TASK.scenarios.draw(scenario_key(SEED, number)).traffic
        np.testing.assert_allclose(flown.start.position_nm[number], start.position_nm, 1e-5)


def test_a_policy_that_samples_draws_anew_in_every_scenario_and_cycle(flown):
    """Twelve draws of five agree by chance once in 5^12."""
    actions = flown.action.tolist()
    assert len({tuple(row) for row in actions}) == SCENARIOS
    assert all(len(set(row)) > 1 for row in actions)
    assert set(flown.instructions.flat) >= {0, 1, 2}  # in every query of a stack, too


def test_another_seed_draws_otherwise(flown, flying):
    assert not np.array_equal(drawn(flying((), SEED + 1, SCENARIOS)), drawn(flown))


@pytest.mark.parametrize("scenarios", [SCENARIOS, 2])
def test_an_agent_draws_under_the_same_keys(flown, scenarios):
    def undecided(seen):
        return np.zeros((len(seen), ACTIONS), dtype=np.float32)

    agent = HostedController(Agent("undecided", scores=undecided, logits=True), greedy=False)
    found = concatenate(list(fly_hosted(TASK, agent, SEED, scenarios, stacking=True)))
    assert found.number.tolist() == list(range(scenarios))
    np.testing.assert_array_equal(drawn(found), drawn(flown)[:scenarios])


def controller():
    return Controller(by_chance)


def test_a_scenario_alone_on_a_platform_draws_under_the_same_keys(flown, tmp_path):
    pilot = Pilot(PlatformRollout(TASK, controller, True, SEED, open_own), tmp_path)
    for number in (3, 1):
        recording = pilot.fly(number)
        assert recording.number.tolist() == [number]
        assert recording.number.dtype == flown.number.dtype == np.int32
        np.testing.assert_array_equal(drawn(recording)[0], drawn(flown)[number])


def test_a_wrong_answer_is_named_with_its_scenario_wherever_that_is_flown():
    """In the last of four, which are flown two at a time; told by what is seen at its start."""
    seen_there = TASK.observe(TASK.reset(scenario_key(SEED, 3)))

    def wild_there(weights, seen, key):
        return jnp.where(jnp.all(jnp.abs(seen - weights) < 1e-4), 99, 0)

    fly = prepare(TASK, wild_there, stacking=False)
    with pytest.raises(InputError, match=r"^scenario 3, cycle 0: action is 99 \("):
        list(fly(seen_there, SEED, SCENARIOS))


def cycle(level, ran, reward, cycles):
    """What is kept of a cycle of two scenarios with one aircraft each."""
    status = AircraftStatus(*[np.array([[each > 1.0] for each in level])] * 3)
    action, instructions = np.array([1, 2]), np.array([1, 3])
    now = traffic((2, 1), level_ticks=np.array(level)[:, None])
    running, paid = np.array(ran), np.array(reward, dtype=np.float32)
    return now, status, action, instructions, running, paid, metrics(2, cycles=cycles)


def test_scenarios_that_end_early_are_recorded_at_full_length():
    """The first ends in cycle 2, the second in cycle 3, of five: their last row stays, nothing
    more happens, and what the task says of each is what it said at its end."""
    rows = [
        cycle([1.0, 1.0], [True, True], [1.0, 10.0], [1.0, 1.0]),
        cycle([2.0, 2.0], [True, True], [2.0, 20.0], [2.0, 2.0]),
        cycle([2.0, 3.0], [False, True], [0.0, 30.0], [99.0, 3.0]),
    ]
    numbers, exit_level_ticks = np.array([4, 9], dtype=np.int32), np.zeros((2, 1), dtype=np.float32)
    found = recording_of(numbers, traffic((2, 1)), exit_level_ticks, rows, 5)
    assert found.ran.tolist() == [[True, True, False, False, False], [True] * 3 + [False] * 2]
    assert (found.traffic.level_ticks[:, :, 0] / 6000).tolist() == [
        [1, 2, 2, 2, 2],
        [1, 2, 3, 3, 3],
    ]
    assert found.status.entered[:, :, 0].tolist() == [[False] + [True] * 4] * 2
    assert found.instructions.tolist() == [[1, 1, 0, 0, 0], [3, 3, 3, 0, 0]]
    assert found.reward.tolist() == [[1, 2, 0, 0, 0], [10, 20, 30, 0, 0]]
    assert found.reward.dtype == np.float32
    assert found.metrics["cycles"].tolist() == [2.0, 3.0]
    # Before its first cycle a scenario is at its start, before each other one after the last.
    assert (found.before("level_ticks")[:, :, 0] / 6000).tolist() == [
        [300, 1, 2, 2, 2],
        [300, 1, 2, 3, 3],
    ]
    both = concatenate([found, found._replace(number=numbers + 1)])
    assert both.number.tolist() == [4, 9, 5, 10]
    assert both.traffic.level_ticks.shape == (4, 5, 1)


def failing():
    return HostedController(Agent("failing", act=lambda seen: 1 // 0))


def test_a_policy_that_fails_on_a_platform_is_named_before_anything_is_flown(tmp_path):
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: the policy failed: ZeroDivis"):
        Pilot(PlatformRollout(TASK, failing, True, SEED, open_own), tmp_path)
