"""`TaskEnvironment`: a task as a Gymnasium environment."""

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
def rendered():
    return gymnasium.make("skystack/Vertical-v0", render_mode="rgb_array")


@pytest.mark.slow
def test_passes_the_checks_of_gymnasium(rendered):
    check_env(rendered.unwrapped)


def test_passes_the_checks_of_stable_baselines3(rendered):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(rendered.unwrapped)


def test_make_accepts_an_experiment_file_or_settings(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text('name = "short"\ndescription = "..."\n[task]\ncycles = 7\n')
    from_file = gymnasium.make("skystack/Lateral-v0", experiment=str(file)).unwrapped
    from_settings = gymnasium.make("skystack/Lateral-v0", settings=NavigationSettings(cycles=7))
    assert from_file.task == from_settings.unwrapped.task
    assert from_file.task.cycles == 7
    with pytest.raises(InputError, match="did you mean 'lateral-best'"):
        gymnasium.make("skystack/Lateral-v0", experiment="lateral-bets")


def test_registration_does_not_import_jax():
    code = "import sys, skystack.gym; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_equal_seeds_give_the_same_scenarios(environment):
    first = [environment.reset(seed=5)[0], *(environment.reset()[0] for _ in range(3))]
    again = [environment.reset(seed=5)[0], *(environment.reset()[0] for _ in range(3))]
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(environment.reset(seed=6)[0], first[0])


def test_steps_agree_with_the_task(environment):
    """Rewards, observations and ends are those of the task; metrics come only at the end."""
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
def test_ends_as_its_task_does(truncates):
    """Terminated or truncated, with the metrics; before the end there are none."""
    counting = TaskEnvironment(Counting(truncates))
    seen, info = counting.reset(seed=0)
    assert info == {}
    length = length_of(seen[0])
    for cycle in range(1, length + 1):
        seen, reward, *ends, info = counting.step(2)
        assert seen.tolist() == pytest.approx([seen[0], cycle / 100, 2 * cycle / 100])
        assert reward == cycle + 20.0
        ended = cycle == length
        assert ends == [ended and not truncates, ended and truncates]
        assert set(info) == (set(Counting.metrics) if ended else set())
    assert (info["cycles"], info["instructions"]) == (length, 2.0 * length)
    assert (info["success"], info["few_instructions"]) == (True, False)
    assert type(info["success"]) is bool
    assert type(reward) is float


@pytest.mark.parametrize("truncates", [False, True])
def test_sums_rewards_of_agents_and_ends_with_the_last(truncates):
    one, two = (TaskEnvironment(Counting(truncates, agents)) for agents in (1, 2))
    assert np.array_equal(one.reset(seed=0)[0], two.reset(seed=0)[0])
    ended = False
    while not ended:
        (_, *expected), (_, *found) = one.step(2), two.step(2)
        assert found == expected
        ended = expected[1] or expected[2]


def test_flattens_structured_observations():
    flat, structured = TaskEnvironment(Counting()), TaskEnvironment(Structured())
    for environment in (flat, structured):
        seen, _ = environment.reset(seed=0)
        assert seen in environment.observation_space
    assert np.array_equal(structured.observe(), flat.observe())
    assert np.array_equal(structured.step(2)[0], flat.step(2)[0])


def test_scenarios_differ_without_a_seed():
    """Between two environments, and between the resets of each."""
    numbers = []
    for _ in range(2):
        counting = TaskEnvironment(Counting())
        numbers += [float(counting.reset()[0][0]) for _ in range(3)]
    assert len(set(numbers)) == 6


def test_observations_are_copies_within_their_space():
    counting = TaskEnvironment(Counting())
    seen, _ = counting.reset(seed=0)
    seen[:] = 7.0
    assert counting.observe()[1] == 0.0
    space = counting.observation_space
    assert (space.shape, space.dtype) == ((3,), np.float32)
    assert (space.low.tolist(), space.high.tolist()) == ([0.0] * 3, [1.0] * 3)
    assert counting.action_space.n == 3


def test_may_stack_is_that_of_the_task():
    """Two instructions of 2 sum to 4, the maximum until the next cycle."""
    counting = TaskEnvironment(Counting())
    counting.reset(seed=0)
    assert [counting.may_stack(action) for action in range(3)] == [False, True, True]
    counting.instruct(2)
    assert counting.may_stack(2)
    counting.instruct(2)
    assert not counting.may_stack(1)
    assert counting.advance()[0] == 41.0
    assert counting.may_stack(1)


@pytest.mark.slow
def test_step_equals_instruct_and_advance(environment):
    """The traffic and the task's memory are bit-identical."""
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


def test_gymnasium_time_limit_truncates():
    limited = gymnasium.make("skystack/Vertical-v0", max_episode_steps=3)
    limited.reset(seed=0)
    flags = [limited.step(0)[2:4] for _ in range(3)]
    assert flags == [(False, False), (False, False), (False, True)]


@pytest.mark.parametrize("action", [-1, 3, 1.0, "left", None])
def test_rejects_an_action_outside_the_table(environment, action):
    environment.reset(seed=0)
    for use in (environment.step, environment.instruct, environment.may_stack):
        with pytest.raises(InputError, match="allowed: whole numbers from 0 to 2"):
            use(action)


def test_step_before_reset_is_an_error():
    environment = TaskEnvironment(build_task(NavigationSettings()))
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(0)


def count_pixels(picture, colour):
    """The number of pixels with a colour."""
    rgb = [int(colour[index : index + 2], 16) for index in (1, 3, 5)]
    return int(np.sum(np.all(picture == rgb, axis=2)))


def test_radar_picture_follows_the_flight(rendered):
    """Trails and labels change during the flight; a reset restores the first picture."""
    from skystack.reporting.style import BLUE

    rendered.reset(seed=4)
    initial = rendered.render()
    assert np.array_equal(rendered.render(), initial)
    for _ in range(40):
        rendered.step(0)
    later = rendered.render()

    assert later.shape == initial.shape
    assert count_pixels(initial, BLUE) > 50
    assert not np.array_equal(later, initial)
    rendered.reset(seed=4)
    assert np.array_equal(rendered.render(), initial)


def test_radar_shows_a_clearance_before_it_is_flown(rendered):
    rendered.reset(seed=4)
    before, environment = rendered.render(), rendered.unwrapped
    allowed = next(action for action in (1, 2) if environment.may_stack(action))
    environment.instruct(allowed)
    assert not np.array_equal(rendered.render(), before)
    traffic = environment.task_state.traffic
    change_fl = (traffic.cleared_level_ticks - traffic.level_ticks) / TICKS_PER_FL
    assert change_fl.tolist() == [{1: -10.0, 2: 10.0}[allowed]]


def test_rejects_an_unknown_render_mode():
    with pytest.raises(InputError, match="allowed: rgb_array"):
        gymnasium.make("skystack/Lateral-v0", render_mode="ansi")
