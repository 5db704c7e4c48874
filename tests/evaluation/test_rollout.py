"""Each scenario has its own keys: it flies the same alone, among others and in every loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.agents.agent import Agent
from skystack.compilation.shared import shared_program
from skystack.errors import InputError
from skystack.evaluation import rollout
from skystack.evaluation.hosted import AgentController, fly_with_agent
from skystack.evaluation.platform_rollout import Pilot, PlatformRollout
from skystack.evaluation.rollout import (
    Controller,
    Recording,
    concatenate,
    fly,
    prepare,
    recording_of,
)
from skystack.learning.seeds import scenario_key
from skystack.tasks.contract import AircraftStatus
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

from .faulty import open_own
from .recordings import metrics, traffic

SEED, SCENARIOS = 3, 4
TASK = build_task(NavigationSettings(cycles=12))
ACTIONS = len(TASK.action_names)


def random_action(weights, observation, key):
    """All actions are equally probable."""
    return jax.random.categorical(key, jnp.zeros(ACTIONS))


def sampled(recording):
    return np.stack([recording.action, recording.instructions], axis=-1)


@pytest.fixture(scope="module", autouse=True)
def two_at_once():
    """Fly the four scenarios in blocks, as thousands would be."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollout, "SCENARIOS_AT_ONCE", 2)
        yield


@pytest.fixture(scope="module")
def fly_all():
    fly = prepare(TASK, random_action, stacking=True)
    return lambda *arguments: concatenate(list(fly(*arguments)))


@pytest.fixture(scope="module")
def flown(fly_all):
    return fly_all((), SEED, SCENARIOS)


@pytest.mark.slow
def test_each_scenario_is_drawn_from_its_own_key(flown):
    assert flown.number.tolist() == list(range(SCENARIOS))
    for number in range(SCENARIOS):
        start = TASK.scenarios.draw(scenario_key(SEED, number)).traffic
        np.testing.assert_allclose(flown.start.position_nm[number], start.position_nm, 1e-5)


def test_sampling_differs_between_scenarios_and_cycles(flown):
    """Two scenarios agree by chance once in 5^12."""
    actions = flown.action.tolist()
    assert len({tuple(row) for row in actions}) == SCENARIOS
    assert all(len(set(row)) > 1 for row in actions)
    assert set(flown.instructions.flat) >= {0, 1, 2}  # and between the queries of a stack


def test_sampling_depends_on_the_seed(flown, fly_all):
    assert not np.array_equal(sampled(fly_all((), SEED + 1, SCENARIOS)), sampled(flown))


@pytest.mark.slow
@pytest.mark.parametrize("scenarios", [SCENARIOS, 2])
def test_an_agent_samples_with_the_same_keys(flown, scenarios):
    def undecided(observations):
        return np.zeros((len(observations), ACTIONS), dtype=np.float32)

    agent = AgentController(Agent("undecided", scores=undecided, logits=True), greedy=False)
    found = concatenate(list(fly_with_agent(TASK, agent, SEED, scenarios, stacking=True)))
    assert found.number.tolist() == list(range(scenarios))
    np.testing.assert_array_equal(sampled(found), sampled(flown)[:scenarios])


def controller():
    return Controller(random_action)


@pytest.mark.slow
def test_a_single_scenario_on_a_platform_has_the_same_keys(flown, tmp_path):
    pilot = Pilot(PlatformRollout(TASK, controller, True, SEED, open_own), tmp_path)
    for number in (3, 1):
        recording = pilot.fly(number)
        assert recording.number.tolist() == [number]
        assert recording.number.dtype == flown.number.dtype == np.int32
        np.testing.assert_array_equal(sampled(recording)[0], sampled(flown)[number])


@pytest.mark.parametrize(
    ("scenarios", "sizes"),
    [
        (1, [16]),
        (16, [16]),
        (17, [32]),
        (100, [128]),
        (513, [1000]),
        (1000, [1000]),
        (1003, [1000, 16]),
    ],
)
def test_blocks_are_filled_up_to_a_few_sizes(scenarios, sizes, monkeypatch):
    """And only the scenarios that are asked for are recorded."""
    monkeypatch.setattr(rollout, "SCENARIOS_AT_ONCE", 1000)
    flown = []

    def program(function, task, decide):
        def fly_block(limit, weights, keys, numbers):
            flown.append(len(numbers))
            assert len(keys) == len(numbers)
            return Recording(numbers, *[numbers * 0] * (len(Recording._fields) - 1))

        return fly_block

    monkeypatch.setattr(rollout, "shared_program", program)
    recorded = concatenate(list(prepare(TASK, random_action, True)((), SEED, scenarios)))
    assert flown == sizes
    assert recorded.number.tolist() == list(range(scenarios))


def test_stacked_and_unstacked_flights_share_a_program():
    shared = shared_program(rollout._fly_many, TASK, random_action)
    shared.clear_cache()
    recordings = [
        fly(TASK, Controller(random_action), SEED, 4, stacking) for stacking in (True, False)
    ]
    assert shared._cache_size() == 1
    most = [recording.instructions.max() for recording in recordings]
    assert most[0] > most[1] == 1


@pytest.mark.slow
def test_reports_the_scenario_of_an_invalid_action():
    """In the last of four, flown two at a time; the policy recognises its first observation."""
    first_observation = TASK.observe(TASK.reset(scenario_key(SEED, 3)))

    def invalid_there(weights, observation, key):
        return jnp.where(jnp.all(jnp.abs(observation - weights) < 1e-4), 99, 0)

    fly = prepare(TASK, invalid_there, stacking=False)
    with pytest.raises(InputError, match=r"^scenario 3, cycle 0: action is 99 \("):
        list(fly(first_observation, SEED, SCENARIOS))


def cycle(level, ran, reward, cycles):
    """The record of one cycle of two scenarios with one aircraft each."""
    status = AircraftStatus(*[np.array([[each > 1.0] for each in level])] * 3)
    action, instructions = np.array([1, 2]), np.array([1, 3])
    now = traffic((2, 1), level_ticks=np.array(level)[:, None])
    running, rewards = np.array(ran), np.array(reward, dtype=np.float32)
    return now, status, action, instructions, running, rewards, metrics(2, cycles=cycles)


def test_scenarios_that_end_early_are_recorded_at_full_length():
    """Of five cycles, the first scenario flies two and the second three. After that the traffic
    is repeated, actions and rewards are 0, and the metrics remain those of the last cycle."""
    rows = [
        cycle([1.0, 1.0], [True, True], [1.0, 10.0], [1.0, 1.0]),
        cycle([2.0, 2.0], [True, True], [2.0, 20.0], [2.0, 2.0]),
        cycle([2.0, 3.0], [False, True], [0.0, 30.0], [99.0, 3.0]),
    ]
    numbers, exit_level_ticks = np.array([4, 9], dtype=np.int32), np.zeros((2, 1), dtype=np.float32)
    never = AircraftStatus(*[np.zeros((2, 1), dtype=bool)] * 3)
    found = recording_of(numbers, (traffic((2, 1)), exit_level_ticks, never), rows, 5)
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
    # The start, then the traffic after each previous cycle.
    assert (found.before("level_ticks")[:, :, 0] / 6000).tolist() == [
        [300, 1, 2, 2, 2],
        [300, 1, 2, 3, 3],
    ]
    both = concatenate([found, found._replace(number=numbers + 1)])
    assert both.number.tolist() == [4, 9, 5, 10]
    assert both.traffic.level_ticks.shape == (4, 5, 1)


def failing():
    return AgentController(Agent("failing", act=lambda observation: 1 // 0))


def test_reports_a_failing_policy_before_flying_on_a_platform(tmp_path):
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: the policy failed: ZeroDivis"):
        Pilot(PlatformRollout(TASK, failing, True, SEED, open_own), tmp_path)
