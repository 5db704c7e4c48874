"""Scenarios are flown under their own keys: alone or among others, in whatever loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.agents.agent import Agent
from skystack.evaluation import hosted, rollout
from skystack.evaluation.elsewhere import Job, Pilot
from skystack.evaluation.hosted import HostedController, fly_hosted
from skystack.evaluation.rollout import Controller, prepare
from skystack.seeds import scenario_key
from skystack.tasks.build import build_task
from skystack.tasks.settings import TaskSettings

from .faulty import open_own

SEED, SCENARIOS = 3, 4
TASK = build_task(TaskSettings(cycles=12))
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
        for module in (rollout, hosted):
            patch.setattr(module, "SCENARIOS_AT_ONCE", 2)
        yield


@pytest.fixture(scope="module")
def flying():
    return prepare(TASK, by_chance, stacking=True)


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
    found = fly_hosted(TASK, agent, SEED, scenarios, stacking=True)
    assert found.number.tolist() == list(range(scenarios))
    np.testing.assert_array_equal(drawn(found), drawn(flown)[:scenarios])


def controller():
    return Controller(by_chance)


def test_a_scenario_alone_on_a_platform_draws_under_the_same_keys(flown, tmp_path):
    pilot = Pilot(Job(TASK, controller, True, SEED, open_own), tmp_path)
    for number in (3, 1):
        recording = pilot.fly(number)
        assert recording.number.tolist() == [number]
        np.testing.assert_array_equal(drawn(recording)[0], drawn(flown)[number])
