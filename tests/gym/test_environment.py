"""A task as a Gymnasium environment."""

import subprocess
import sys

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import skystack.gym  # noqa: F401  (registers)
from skystack.errors import InputError
from skystack.gym.environment import TaskEnvironment
from skystack.gym.registration import make_environment
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from tests.gym.counting import Counting, Structured, length_of


@pytest.fixture(scope="module")
def environment():
    return make_environment("vertical")


@pytest.fixture(scope="module")
def drawn():
    return gymnasium.make("skystack/Vertical-v0", render_mode="rgb_array")


def test_gymnasium_has_nothing_to_complain_about(drawn):
    check_env(drawn.unwrapped)


def test_stable_baselines3_has_nothing_to_complain_about(drawn):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(drawn.unwrapped)


def test_an_environment_of_the_users_own_settings(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text('name = "short"\ndescription = "..."\n[task]\ncycles = 7\n')
    from_file = gymnasium.make("skystack/Lateral-v0", experiment=str(file)).unwrapped
    from_settings = gymnasium.make("skystack/Lateral-v0", settings=NavigationSettings(cycles=7))
    assert from_file.task == from_settings.unwrapped.task
    assert from_file.task.cycles == 7
    with pytest.raises(InputError, match="did you mean 'lateral-best'"):
        gymnasium.make("skystack/Lateral-v0", experiment="lateral-bets")


def test_registering_needs_no_jax():
    code = "import sys, skystack.gym; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_seed_gives_the_same_scenarios_in_the_same_order(environment):
    first = [environment.reset(seed=5)[0], *(environment.reset()[0] for _ in range(3))]
    again = [environment.reset(seed=5)[0], *(environment.reset()[0] for _ in range(3))]
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(environment.reset(seed=6)[0], first[0])


def test_a_scenario_goes_as_in_the_task(environment):
    """Rewards, observations and end of the task's own steps; metrics only at the end."""
    task = environment.task
    environment.reset(seed=1)
    state = environment.task_state
    step, observe = jax.jit(task.step), jax.jit(task.observe)
    rng = np.random.default_rng(0)
    for cycle in range(task.cycles):
        action = rng.integers(len(task.action_names)) if cycle < 20 else np.int64(0)
        seen, reward, terminated, truncated, info = environment.step(action)
        state, outcome = step(state, np.int32(action))
        assert np.array_equal(seen, observe(state))
        assert (reward, terminated, truncated) == (outcome.reward, outcome.ended, False)
        if terminated:
            break
        assert info == {}
    assert terminated
    assert info == {key: value.item() for key, value in outcome.metrics.items()}


@pytest.mark.parametrize("truncates", [False, True])
def test_a_scenario_ends_as_its_task_says(truncates):
    """Terminated or truncated, with the metrics; before its end there are none."""
    counting = TaskEnvironment(Counting(truncates))
    seen, info = counting.reset(seed=0)
    assert info == {}
    length = length_of(seen[0])
    for cycle in range(1, length + 1):
        seen, reward, *ends, info = counting.step(2)
        assert seen.tolist() == pytest.approx([seen[0], cycle / 100, 2 * cycle / 100])
        assert reward == cycle + 20.0
        over = cycle == length
        assert ends == [over and not truncates, over and truncates]
        assert set(info) == (set(Counting.metrics) if over else set())
    assert (info["cycles"], info["instructions"]) == (length, 2.0 * length)
    assert (info["success"], info["few_instructions"]) == (True, False)
    assert type(info["success"]) is bool
    assert type(reward) is float


@pytest.mark.parametrize("truncates", [False, True])
def test_rewards_of_several_agents_are_added_and_all_must_end(truncates):
    one, two = (TaskEnvironment(Counting(truncates, agents)) for agents in (1, 2))
    assert np.array_equal(one.reset(seed=0)[0], two.reset(seed=0)[0])
    over = False
    while not over:
        (_, *expected), (_, *found) = one.step(2), two.step(2)
        assert found == expected
        over = expected[1] or expected[2]


def test_observations_of_several_parts_are_flattened():
    flat, structured = TaskEnvironment(Counting()), TaskEnvironment(Structured())
    for environment in (flat, structured):
        seen, _ = environment.reset(seed=0)
        assert seen in environment.observation_space
    assert np.array_equal(structured.observe(), flat.observe())
    assert np.array_equal(structured.step(2)[0], flat.step(2)[0])


def test_without_a_seed_scenarios_are_others_each_time():
    """The first reset of two environments, and those that follow one another."""
    drawn = []
    for _ in range(2):
        counting = TaskEnvironment(Counting())
        drawn += [float(counting.reset()[0][0]) for _ in range(3)]
    assert len(set(drawn)) == 6


def test_observations_are_copies_within_their_space():
    counting = TaskEnvironment(Counting())
    seen, _ = counting.reset(seed=0)
    seen[:] = 7.0
    assert counting.observe()[1] == 0.0
    space = counting.observation_space
    assert (space.shape, space.dtype) == ((3,), np.float32)
    assert (space.low.tolist(), space.high.tolist()) == ([0.0] * 3, [1.0] * 3)
    assert counting.action_space.n == 3


def test_what_may_be_stacked_is_the_tasks_answer():
    """Two of twice two are four, which is enough until the next cycle."""
    counting = TaskEnvironment(Counting())
    counting.reset(seed=0)
    assert [counting.may_stack(action) for action in range(3)] == [False, True, True]
    counting.instruct(2)
    assert counting.may_stack(2)
    counting.instruct(2)
    assert not counting.may_stack(1)
    assert counting.advance()[0] == 41.0
    assert counting.may_stack(1)


def test_a_step_is_the_two_phases(environment):
    """The whole state, bit by bit, the radar's and the task's memory."""
    for action in (0, 2, 1):
        environment.reset(seed=2)
        seen, *stepped = environment.step(action)
        by_step = jax.tree.leaves(environment.task_state)
        environment.reset(seed=2)
        environment.instruct(action)
        assert stepped == list(environment.advance())
        assert np.array_equal(seen, environment.observe())
        for one, other in zip(by_step, jax.tree.leaves(environment.task_state), strict=True):
            assert np.array_equal(one, other)


def test_only_gymnasiums_time_limit_truncates():
    limited = gymnasium.make("skystack/Vertical-v0", max_episode_steps=3)
    limited.reset(seed=0)
    flags = [limited.step(0)[2:4] for _ in range(3)]
    assert flags == [(False, False), (False, False), (False, True)]


@pytest.mark.parametrize("action", [-1, 3, 1.0, "left", None])
def test_an_action_that_is_not_in_the_table_is_refused(environment, action):
    environment.reset(seed=0)
    for told in (environment.step, environment.instruct, environment.may_stack):
        with pytest.raises(InputError, match="allowed: whole numbers from 0 to 2"):
            told(action)


def test_nothing_can_be_done_before_the_first_scenario():
    environment = TaskEnvironment(build_task(NavigationSettings()))
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(0)


def coloured(picture, colour):
    """How many pixels have a colour."""
    wanted = [int(colour[place : place + 2], 16) for place in (1, 3, 5)]
    return int(np.sum(np.all(picture == wanted, axis=2)))


def test_the_radar_picture_follows_the_flight(drawn):
    """The trail, and the level in the label, come with the flight; a new scenario has neither."""
    from skystack.reporting.style import BLUE

    drawn.reset(seed=4)
    begun = drawn.render()
    assert np.array_equal(drawn.render(), begun)
    for _ in range(40):
        drawn.step(0)
    flown = drawn.render()

    assert flown.shape == begun.shape
    assert coloured(begun, BLUE) > 50
    assert not np.array_equal(flown, begun)
    drawn.reset(seed=4)
    assert np.array_equal(drawn.render(), begun)


def test_the_radar_shows_what_is_cleared_before_it_is_flown(drawn):
    drawn.reset(seed=4)
    before, radar = drawn.render(), drawn.unwrapped
    allowed = next(action for action in (1, 2) if radar.may_stack(action))
    radar.instruct(allowed)
    assert not np.array_equal(drawn.render(), before)
    traffic = radar.task_state.traffic
    change_fl = (traffic.cleared_level_ticks - traffic.level_ticks) / TICKS_PER_FL
    assert change_fl.tolist() == [{1: -10.0, 2: 10.0}[allowed]]


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(InputError, match="allowed: rgb_array"):
        gymnasium.make("skystack/Lateral-v0", render_mode="ansi")
