"""Sector control as a vector environment with one sub-environment per slot."""

import copy

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from skystack.errors import InputError
from skystack.gym.registration import make_environment, make_vector_environment
from skystack.gym.sector import SectorVectorEnvironment, make_sector_environment
from skystack.tasks.sector_control import CLIMB, DESCEND, NONE, TO_FIX
from tests.tasks.sector_traffic import SETTINGS, SLOTS


@pytest.fixture(scope="module")
def environment():
    return make_sector_environment(settings=SETTINGS)


def run(environment, seed, steps, action=TO_FIX):
    results = [environment.reset(seed=seed)]
    for _ in range(steps):
        results.append(environment.step(np.full(SLOTS, action)))
    return results


@pytest.mark.slow
def test_it_agrees_with_the_task(environment):
    observation, infos = environment.reset(seed=3)
    task, state = environment.task, environment.task_state
    step, observe = jax.jit(task.step), jax.jit(task.observe)
    actions = jnp.full(SLOTS, TO_FIX, dtype=jnp.int32)
    for _ in range(30):
        state, outcome = step(state, actions)
        observation, reward, terminated, truncated, infos = environment.step(np.asarray(actions))
        active = np.asarray(task.active(state))
        np.testing.assert_array_equal(infos["active"], active)
        np.testing.assert_allclose(
            observation, np.where(active[:, None], np.asarray(observe(state)).T, 0.0), atol=1e-6
        )
        np.testing.assert_allclose(reward, outcome.reward, atol=1e-5)
        np.testing.assert_array_equal(terminated, outcome.terminated)
        assert not truncated.any()
    assert infos["active"].any()
    assert environment.observation_space.contains(observation)


@pytest.mark.slow
def test_masked_actions_change_nothing_and_others_do(environment):
    infos = run(environment, 5, 40)[-1][-1]
    before = environment.task_state
    mask, active = infos["action_mask"], infos["active"]
    assert mask[:, NONE].all()
    assert not mask[~active, 1:].any()
    instruct = jax.jit(environment.task.instruct)
    for action in range(1, mask.shape[1]):
        told = instruct(before, jnp.full(SLOTS, action, dtype=jnp.int32)).world.traffic
        same = np.ones(SLOTS, dtype=bool)
        for name in ("cleared_level_ticks", "cleared_heading_deg", "pending_turn"):
            one, two = (np.asarray(getattr(x, name)) for x in (before.world.traffic, told))
            same &= one == two
        np.testing.assert_array_equal(same[active], ~mask[active, action])


def test_the_scenario_ends_for_all_flights_and_begins_anew(environment):
    environment.reset(seed=1)
    ended = False
    for _ in range(SETTINGS.cycles):
        active = environment.step(np.zeros(SLOTS, dtype=int))[-1]["active"]
        if environment._ended:
            ended = True
            break
    assert ended
    assert int(environment.task_state.world.arrivals.cycle) >= SETTINGS.cycles // 3
    _observation, reward, terminated, truncated, infos = environment.step(
        np.full(SLOTS, CLIMB, dtype=int)
    )
    assert int(environment.task_state.world.arrivals.cycle) == 0
    assert active.shape == infos["active"].shape
    assert not reward.any()
    assert not terminated.any()
    assert not truncated.any()
    assert "metrics" not in infos


def test_truncation_and_metrics_come_at_the_end(environment):
    environment.reset(seed=2)
    while True:
        heard = environment._view.active
        *_, terminated, truncated, infos = environment.step(np.full(SLOTS, TO_FIX))
        if environment._ended:
            break
    np.testing.assert_array_equal(truncated[heard], ~terminated[heard])
    assert infos["metrics"]["flights"] >= 0.0


def test_equal_seeds_give_equal_scenarios_and_copies_continue_alike(environment):
    first, second = run(environment, 7, 20), run(environment, 7, 20)
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one[0], two[0])
    other = copy.deepcopy(environment)
    actions = np.full(SLOTS, DESCEND)
    for one, two in zip(environment.step(actions), other.step(actions), strict=True):
        if isinstance(one, dict):
            np.testing.assert_array_equal(one["action_mask"], two["action_mask"])
        else:
            np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("actions", [[0], np.full(SLOTS, 6), np.full(SLOTS, -1), np.zeros(SLOTS)])
def test_actions_that_are_not_in_the_table_are_refused(environment, actions):
    environment.reset(seed=0)
    with pytest.raises(InputError, match="whole numbers from 0 to 5"):
        environment.step(actions)


def test_a_reset_comes_first(environment):
    with pytest.raises(ResetNeeded):
        SectorVectorEnvironment(environment.task, environment.programs).step(
            np.zeros(SLOTS, dtype=int)
        )


@pytest.mark.parametrize("make", [make_environment, make_vector_environment])
def test_environments_of_one_agent_refuse_sector_control(make):
    with pytest.raises(InputError, match="has many agents"):
        make("sector-control")


def test_other_tasks_are_refused():
    with pytest.raises(InputError, match=r"task lateral is not for sectors \(allowed: sector-"):
        make_sector_environment("lateral")
