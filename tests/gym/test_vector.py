"""`VectorTaskEnvironment` agrees with Gymnasium's vector environment of single environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import skystack.gym  # noqa: F401  (registers)
from skystack.errors import InputError
from skystack.gym.environment import TaskEnvironment
from skystack.gym.registration import make_environment, make_vector_environment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.learning.experiment import load_experiment
from skystack.tasks.registry import build_task
from tests.gym.counting import Counting, Structured, length_of

SCENARIOS, STEPS = 3, 300
NAME = "skystack/Avoidance-v0"


@pytest.fixture(scope="module")
def task():
    return build_task(load_experiment("avoidance").task)


def single():
    return make_environment("avoidance")


@pytest.fixture(scope="module")
def vector(task):
    """Makes vector environments that share their compiled programs."""
    first = VectorTaskEnvironment(task, SCENARIOS)

    def make(*options, **keywords):
        return VectorTaskEnvironment(task, SCENARIOS, *options, programs=first.programs, **keywords)

    return make


def check_equal(ours, theirs):
    """Check that two results are equal; numbers up to the rounding of different programs."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for key in ours:
            check_equal(ours[key], theirs[key])
    elif ours.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            if one is not None or other is not None:
                check_equal(one, other)
    else:
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=2e-4)


def check_same_flights(ours, theirs, seed, steps):
    """Fly both with the same actions; returns the number of ended scenarios."""
    for one, other in zip(ours.reset(seed=seed), theirs.reset(seed=seed), strict=True):
        check_equal(one, other)
    assert ours.np_random_seed == theirs.np_random_seed
    rng, ended = np.random.default_rng(0), 0
    for _ in range(steps):
        actions = rng.integers(5, size=SCENARIOS) * (rng.random(SCENARIOS) < 0.2)
        step = ours.step(actions)
        for one, other in zip(step, theirs.step(actions), strict=True):
            check_equal(one, other)
        ended += int((step[2] | step[3]).sum())
    return ended


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("seed", [7, [3, 1, 4]])
def test_agrees_with_the_synchronous_vector_environment(vector, mode, seed):
    """Including the ends of scenarios and the scenarios that follow."""
    theirs = SyncVectorEnv([single] * SCENARIOS, autoreset_mode=mode)
    ours = vector(mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert check_same_flights(ours, theirs, seed, STEPS) >= SCENARIOS


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_time_limit_truncates_as_in_gymnasium(vector, mode):
    limited = [lambda: gymnasium.wrappers.TimeLimit(single(), 9)] * SCENARIOS
    theirs = SyncVectorEnv(limited, autoreset_mode=mode)
    ours = vector(mode, max_episode_steps=9)
    assert check_same_flights(ours, theirs, 0, 30) == 3 * SCENARIOS


def counting(*options, truncates=False, **keywords):
    return VectorTaskEnvironment(Counting(truncates), 4, *options, **keywords)


def reset_to_all_lengths(environment, **options):
    """Reset with a seed whose four scenarios take 2, 3 and 4 cycles; first observations."""
    for seed in range(100):
        seen, _ = environment.reset(seed=seed, **options)
        if {2, 3, 4} == set(length_of(seen[:, 0]).tolist()):
            return seen
    raise AssertionError("no such seed")


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(("truncates", "limit"), [(False, None), (False, 3), (True, None)])
def test_scenarios_run_and_end_independently(mode, truncates, limit):
    """Rewards, ends, observations and metrics in closed form, and the scenarios that follow."""
    environment = counting(mode, limit, truncates=truncates)
    seen = reset_to_all_lengths(environment)
    drawn, lengths = seen[:, 0], length_of(seen[:, 0])
    actions, ended = np.array([1, 2, 1, 0]), np.zeros(4, dtype=bool)
    for cycle in range(1, 5):
        seen, rewards, terminated, truncated, infos = environment.step(actions)
        for number in np.flatnonzero(~ended):
            length, action = lengths[number], int(actions[number])
            last = [drawn[number], cycle / 100, cycle * action / 100]
            ends, cut = length == cycle, limit == cycle
            assert rewards[number] == cycle + 10.0 * action
            assert terminated[number] == (ends and not truncates)
            assert truncated[number] == ((ends and truncates) or cut)
            if not ends and not cut:
                np.testing.assert_allclose(seen[number], last, rtol=1e-6)
                continue
            metrics = infos if mode == "NextStep" else infos["final_info"]
            assert ("cycles" in metrics and bool(metrics["_cycles"][number])) == ends
            if ends:
                assert metrics["cycles"][number] == cycle
                assert metrics["instructions"][number] == cycle * action
            if mode == "SameStep":
                np.testing.assert_allclose(infos["final_obs"][number], last, rtol=1e-6)
                assert seen[number, 0] != drawn[number]
                assert seen[number, 1:].tolist() == [0.0, 0.0]
                continue
            np.testing.assert_allclose(seen[number], last, rtol=1e-6)
        if mode == "NextStep":
            for number in np.flatnonzero(ended & (lengths + 1 == cycle)):
                assert (rewards[number], terminated[number], truncated[number]) == (0, False, False)
                assert seen[number, 1:].tolist() == [0.0, 0.0]
        ended |= terminated | truncated
    assert ended.all()


def test_sums_rewards_of_agents_and_ends_with_the_last():
    one, two = (VectorTaskEnvironment(Counting(agents=agents), 4) for agents in (1, 2))
    reset_to_all_lengths(one), reset_to_all_lengths(two)
    for _ in range(8):
        for expected, found in zip(one.step([0, 1, 2, 2]), two.step([0, 1, 2, 2]), strict=True):
            check_equal(found, expected)


def test_flattens_structured_observations():
    flat, structured = (VectorTaskEnvironment(task, 4) for task in (Counting(), Structured()))
    for expected, found in (
        (flat.reset(seed=0)[0], structured.reset(seed=0)[0]),
        (flat.step([0, 1, 2, 2])[0], structured.step([0, 1, 2, 2])[0]),
    ):
        np.testing.assert_array_equal(found, expected)


def test_time_limit_counts_from_the_start_of_each_scenario():
    """Also after a reset in the middle of a scenario."""
    environment = counting("SameStep", 2)
    environment.reset(seed=0)
    environment.step(np.zeros(4, dtype=int))
    environment.reset(seed=0)
    steps = [environment.step(np.zeros(4, dtype=int)) for _ in range(4)]
    ended = [(terminated | truncated).tolist() for *_, terminated, truncated, _ in steps]
    assert ended == [[False] * 4, [True] * 4] * 2


def test_scenarios_use_consecutive_seeds():
    environment, alone = counting(), TaskEnvironment(Counting())
    seen, _ = environment.reset(seed=7)
    expected = [alone.reset(seed=seed)[0] for seed in range(7, 11)]
    np.testing.assert_array_equal(seen, expected)
    assert environment.np_random_seed == (7, 8, 9, 10)
    alone.reset(seed=9)
    following, _ = alone.reset()
    np.testing.assert_array_equal(environment.reset()[0][2], following)


def test_reset_without_a_seed_draws_new_scenarios(vector):
    environment = vector()
    first, _ = environment.reset(seed=0)
    second, _ = environment.reset()
    assert not np.array_equal(first, second)
    environment.reset(seed=0)
    assert np.array_equal(environment.reset()[0], second)


MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_reset_mask_restarts_the_same_scenarios_as_gymnasium(vector, mode):
    """With and without seeds; the scenarios are running, truncated or just restarted."""
    limited = [lambda: gymnasium.wrappers.TimeLimit(single(), 9)] * SCENARIOS
    theirs = SyncVectorEnv(limited, autoreset_mode=mode)
    ours = vector(mode, max_episode_steps=9)
    both = (ours, theirs)

    def reset(mask, seed):
        """Reset both; each gets its own options, because Gymnasium removes the mask from them."""
        resets = [each.reset(seed=seed, options={"reset_mask": mask.copy()}) for each in both]
        for one, other in zip(*resets, strict=True):
            check_equal(one, other)
        assert ours.np_random_seed == theirs.np_random_seed

    reset(np.ones(SCENARIOS, dtype=bool), 5)
    rng, ended = np.random.default_rng(1), 0
    seeds = [None, 11, [21, None, 23], None]
    for step in range(40):
        actions = rng.integers(5, size=SCENARIOS)
        steps = [each.step(actions) for each in both]
        for one, other in zip(*steps, strict=True):
            check_equal(one, other)
        done = steps[0][2] | steps[0][3]
        ended += int(done.sum())
        if step % 4 == 3:
            reset(np.arange(SCENARIOS) == (step // 4) % SCENARIOS, seeds[step // 4 % 4])
        elif done.any() and mode is AutoresetMode.DISABLED:
            reset(done, None)
    assert ended >= SCENARIOS


def test_reset_does_not_modify_its_options(vector):
    environment = vector()
    environment.reset(seed=0)
    options = {"reset_mask": np.array([True, False, False])}
    environment.reset(options=options)
    assert options["reset_mask"].tolist() == [True, False, False]


@pytest.mark.parametrize(
    "mask",
    [
        [True, False, True],
        np.array([1, 0, 1]),
        np.array([True, False]),
        np.array([[True, False, True]]),
        np.zeros(SCENARIOS, dtype=bool),
        None,
    ],
)
def test_rejects_invalid_masks_as_gymnasium_does(vector, mask):
    theirs, ours = SyncVectorEnv([single] * SCENARIOS), vector()
    ours.reset(seed=0)
    with pytest.raises((TypeError, ValueError), match="reset_mask"):
        theirs.reset(options={"reset_mask": mask})
    with pytest.raises(InputError, match="allowed: a numpy array of 3 booleans"):
        ours.reset(seed=9, options={"reset_mask": mask})
    assert ours.np_random_seed == (0, 1, 2)


def test_mask_requires_an_earlier_full_reset(vector):
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector().reset(options={"reset_mask": np.array([True, False, True])})


def test_ended_scenarios_must_be_reset_without_autoreset(vector):
    environment = vector("Disabled", max_episode_steps=2)
    environment.reset(seed=0)
    no_ops = np.zeros(SCENARIOS, dtype=int)
    environment.step(no_ops)
    environment.reset(options={"reset_mask": np.array([False, True, False])})
    *_, truncated, _ = environment.step(no_ops)
    assert truncated.tolist() == [True, False, True]
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"scenarios \[0, 2\] have ended"):
        environment.step(no_ops)
    environment.reset(options={"reset_mask": truncated})
    assert environment.step(no_ops)[3].tolist() == [False, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_renders_the_pictures_of_single_environments(vector, mode):
    """Trails grow, and start again if a scenario is restarted at its end or by a mask."""

    def limited():
        environment = make_environment("avoidance", render_mode="rgb_array")
        return gymnasium.wrappers.TimeLimit(environment, 12)

    theirs = SyncVectorEnv([limited] * SCENARIOS, autoreset_mode=mode)
    ours = vector(mode, max_episode_steps=12, render_mode="rgb_array")
    both = (ours, theirs)
    assert ours.render_mode == theirs.render_mode
    assert ours.metadata == theirs.metadata
    for each in both:
        each.reset(seed=0)
    before = ours.render()
    mask = np.array([True, False, False])
    for step in range(1, 15):
        for each in both:
            each.step(np.array([1, 2, 3]))
        if step == 9:
            for each in both:
                each.reset(options={"reset_mask": mask.copy()})
        if step in (1, 9, 11, 12, 13):
            for found, expected in zip(*(each.render() for each in both), strict=True):
                assert found.dtype == np.uint8
                # The two programs round positions differently, which may change single pixels.
                assert np.mean(np.any(found != expected, axis=2)) < 1e-4
    assert not np.array_equal(ours.render()[1], before[1])


@pytest.mark.slow
def test_make_vec_with_rendering():
    environment = gymnasium.make_vec(NAME, num_envs=2, render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.render()
    environment.reset(seed=0)
    first, second = environment.render()
    assert first.shape == second.shape
    assert not np.array_equal(first, second)
    without_rendering = gymnasium.make_vec(NAME, num_envs=2)
    without_rendering.reset(seed=0)
    assert without_rendering.render() is None
    with pytest.raises(InputError, match=r"render_mode is human \(allowed: rgb_array\)"):
        gymnasium.make_vec(NAME, num_envs=2, render_mode="human")


@pytest.mark.slow
def test_make_vec():
    environment = gymnasium.make_vec(NAME, num_envs=4, autoreset_mode="SameStep")
    assert isinstance(environment, VectorTaskEnvironment)
    assert environment.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert environment.reset(seed=0)[0] in environment.observation_space


def test_accepts_every_action_of_the_table():
    environment = counting()
    environment.reset(seed=0)
    assert environment.step([0, 1, 2, np.int8(2)])[1].tolist() == [1.0, 11.0, 21.0, 21.0]


@pytest.mark.parametrize("actions", [[0, 0], [0, 0, 5], [0, 0, -1], [0.0, 0.0, 0.0]])
def test_rejects_actions_outside_the_table(vector, actions):
    environment = vector()
    environment.reset(seed=0)
    with pytest.raises(InputError, match="allowed: 3 whole numbers from 0 to 4"):
        environment.step(np.array(actions))


def test_rejects_invalid_arguments(task, vector, types_unchecked):
    with pytest.raises(InputError, match="allowed: NextStep, SameStep, Disabled"):
        VectorTaskEnvironment(task, SCENARIOS, "Never")
    assert VectorTaskEnvironment(task, 1, max_episode_steps=1).num_envs == 1
    with pytest.raises(InputError, match="max_episode_steps is 0"):
        VectorTaskEnvironment(task, SCENARIOS, max_episode_steps=0)
    with pytest.raises(InputError, match="num_envs is 0"):
        make_vector_environment("lateral", 0)
    with pytest.raises(InputError, match=r"a list of 2 \(allowed: 3\)"):
        vector().reset(seed=[1, 2])
    for seed in (1.5, np.array(1)):
        with pytest.raises(InputError, match=r"^seed is .* \(allowed: a whole number, or a list"):
            vector().reset(seed=seed)
    with pytest.raises(InputError, match=r"^max_episode_steps is 2.5 \(allowed: whole "):
        VectorTaskEnvironment(task, SCENARIOS, max_episode_steps=2.5)
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector().step(np.zeros(SCENARIOS, dtype=int))
