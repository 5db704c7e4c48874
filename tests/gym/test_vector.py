"""Many scenarios in one program are what Gymnasium makes of single environments."""

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
    """Environments that share their compiled programs."""
    first = VectorTaskEnvironment(task, SCENARIOS)

    def another(*options, **more):
        return VectorTaskEnvironment(task, SCENARIOS, *options, programs=first.programs, **more)

    return another


def alike(ours, theirs):
    """Equal, numbers up to rounding: two programs may round differently."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for key in ours:
            alike(ours[key], theirs[key])
    elif ours.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            if one is not None or other is not None:
                alike(one, other)
    else:
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=2e-4)


def check_the_same(ours, theirs, seed, steps):
    """Fly both with the same actions; returns how many scenarios ended."""
    for one, other in zip(ours.reset(seed=seed), theirs.reset(seed=seed), strict=True):
        alike(one, other)
    assert ours.np_random_seed == theirs.np_random_seed
    rng, ended = np.random.default_rng(0), 0
    for _ in range(steps):
        actions = rng.integers(5, size=SCENARIOS) * (rng.random(SCENARIOS) < 0.2)
        step = ours.step(actions)
        for one, other in zip(step, theirs.step(actions), strict=True):
            alike(one, other)
        ended += int((step[2] | step[3]).sum())
    return ended


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("seed", [7, [3, 1, 4]])
def test_it_is_the_synchronous_vector_environment(vector, mode, seed):
    """Through scenarios that end by themselves, and those that follow them."""
    theirs = SyncVectorEnv([single] * SCENARIOS, autoreset_mode=mode)
    ours = vector(mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert check_the_same(ours, theirs, seed, STEPS) >= SCENARIOS


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_time_limit_truncates_as_gymnasiums_does(vector, mode):
    limited = [lambda: gymnasium.wrappers.TimeLimit(single(), 9)] * SCENARIOS
    theirs = SyncVectorEnv(limited, autoreset_mode=mode)
    ours = vector(mode, max_episode_steps=9)
    assert check_the_same(ours, theirs, 0, 30) == 3 * SCENARIOS


def counted(*options, truncates=False, **more):
    return VectorTaskEnvironment(Counting(truncates), 4, *options, **more)


def all_lengths(environment, **options):
    """A seed whose four scenarios take 2, 3 and 4 cycles, with their first observations."""
    for seed in range(100):
        seen, _ = environment.reset(seed=seed, **options)
        if {2, 3, 4} == set(length_of(seen[:, 0]).tolist()):
            return seen
    raise AssertionError("no such seed")


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(("truncates", "limit"), [(False, None), (False, 3), (True, None)])
def test_each_scenario_goes_and_ends_by_itself(mode, truncates, limit):
    """Rewards, ends, observations and metrics by their formulas, and what follows the end."""
    environment = counted(mode, limit, truncates=truncates)
    seen = all_lengths(environment)
    drawn, lengths = seen[:, 0], length_of(seen[:, 0])
    actions, over = np.array([1, 2, 1, 0]), np.zeros(4, dtype=bool)
    for cycle in range(1, 5):
        seen, rewards, terminated, truncated, infos = environment.step(actions)
        for number in np.flatnonzero(~over):
            own, told = lengths[number], int(actions[number])
            last = [drawn[number], cycle / 100, cycle * told / 100]
            ends, cut = own == cycle, limit == cycle
            assert rewards[number] == cycle + 10.0 * told
            assert terminated[number] == (ends and not truncates)
            assert truncated[number] == ((ends and truncates) or cut)
            if not ends and not cut:
                np.testing.assert_allclose(seen[number], last, rtol=1e-6)
                continue
            judged = infos if mode == "NextStep" else infos["final_info"]
            assert ("cycles" in judged and bool(judged["_cycles"][number])) == ends
            if ends:
                assert judged["cycles"][number] == cycle
                assert judged["instructions"][number] == cycle * told
            if mode == "SameStep":
                np.testing.assert_allclose(infos["final_obs"][number], last, rtol=1e-6)
                assert seen[number, 0] != drawn[number]
                assert seen[number, 1:].tolist() == [0.0, 0.0]
                continue
            np.testing.assert_allclose(seen[number], last, rtol=1e-6)
        if mode == "NextStep":
            for number in np.flatnonzero(over & (lengths + 1 == cycle)):
                assert (rewards[number], terminated[number], truncated[number]) == (0, False, False)
                assert seen[number, 1:].tolist() == [0.0, 0.0]
        over |= terminated | truncated
    assert over.all()


def test_rewards_of_several_agents_are_added_and_all_must_end():
    one, two = (VectorTaskEnvironment(Counting(agents=agents), 4) for agents in (1, 2))
    all_lengths(one), all_lengths(two)
    for _ in range(8):
        for expected, found in zip(one.step([0, 1, 2, 2]), two.step([0, 1, 2, 2]), strict=True):
            alike(found, expected)


def test_observations_of_several_parts_are_flattened():
    flat, structured = (VectorTaskEnvironment(task, 4) for task in (Counting(), Structured()))
    for expected, found in (
        (flat.reset(seed=0)[0], structured.reset(seed=0)[0]),
        (flat.step([0, 1, 2, 2])[0], structured.step([0, 1, 2, 2])[0]),
    ):
        np.testing.assert_array_equal(found, expected)


def test_a_limit_counts_from_each_scenarios_own_begin():
    """Also where the reset of all comes in the middle of one."""
    environment = counted("SameStep", 2)
    environment.reset(seed=0)
    environment.step(np.zeros(4, dtype=int))
    environment.reset(seed=0)
    flags = [environment.step(np.zeros(4, dtype=int)) for _ in range(4)]
    over = [(terminated | truncated).tolist() for *_, terminated, truncated, _ in flags]
    assert over == [[False] * 4, [True] * 4] * 2


def test_a_seed_is_that_of_the_first_and_the_others_count_on():
    environment, alone = counted(), TaskEnvironment(Counting())
    seen, _ = environment.reset(seed=7)
    each = [alone.reset(seed=seed)[0] for seed in range(7, 11)]
    np.testing.assert_array_equal(seen, each)
    assert environment.np_random_seed == (7, 8, 9, 10)
    alone.reset(seed=9)
    follow, _ = alone.reset()
    np.testing.assert_array_equal(environment.reset()[0][2], follow)


def test_after_a_reset_without_a_seed_new_scenarios_follow(vector):
    environment = vector()
    first, _ = environment.reset(seed=0)
    second, _ = environment.reset()
    assert not np.array_equal(first, second)
    environment.reset(seed=0)
    assert np.array_equal(environment.reset()[0], second)


MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]


@pytest.mark.parametrize("mode", MODES)
def test_a_mask_restarts_what_gymnasium_restarts(vector, mode):
    """With and without seeds, among scenarios under way, cut short, and just restarted."""
    limited = [lambda: gymnasium.wrappers.TimeLimit(single(), 9)] * SCENARIOS
    theirs = SyncVectorEnv(limited, autoreset_mode=mode)
    ours = vector(mode, max_episode_steps=9)
    both = (ours, theirs)

    def reset(mask, seed):
        """Gymnasium takes the mask out of the options that it is given."""
        resets = [each.reset(seed=seed, options={"reset_mask": mask.copy()}) for each in both]
        for one, other in zip(*resets, strict=True):
            alike(one, other)
        assert ours.np_random_seed == theirs.np_random_seed

    reset(np.ones(SCENARIOS, dtype=bool), 5)
    rng, ended = np.random.default_rng(1), 0
    seeds = [None, 11, [21, None, 23], None]
    for step in range(40):
        actions = rng.integers(5, size=SCENARIOS)
        steps = [each.step(actions) for each in both]
        for one, other in zip(*steps, strict=True):
            alike(one, other)
        over = steps[0][2] | steps[0][3]
        ended += int(over.sum())
        if step % 4 == 3:
            reset(np.arange(SCENARIOS) == (step // 4) % SCENARIOS, seeds[step // 4 % 4])
        elif over.any() and mode is AutoresetMode.DISABLED:
            reset(over, None)
    assert ended >= SCENARIOS


def test_options_are_left_as_they_are(vector):
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
def test_a_mask_of_another_kind_is_refused_as_in_gymnasium(vector, mask):
    theirs, ours = SyncVectorEnv([single] * SCENARIOS), vector()
    ours.reset(seed=0)
    with pytest.raises((TypeError, ValueError), match="reset_mask"):
        theirs.reset(options={"reset_mask": mask})
    with pytest.raises(InputError, match="allowed: a numpy array of 3 booleans"):
        ours.reset(seed=9, options={"reset_mask": mask})
    assert ours.np_random_seed == (0, 1, 2)


def test_some_can_only_be_restarted_after_all_have_begun(vector):
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector().reset(options={"reset_mask": np.array([True, False, True])})


def test_without_autoreset_what_is_over_must_be_reset(vector):
    environment = vector("Disabled", max_episode_steps=2)
    environment.reset(seed=0)
    none = np.zeros(SCENARIOS, dtype=int)
    environment.step(none)
    environment.reset(options={"reset_mask": np.array([False, True, False])})
    *_, truncated, _ = environment.step(none)
    assert truncated.tolist() == [True, False, True]
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"scenarios \[0, 2\] have ended"):
        environment.step(none)
    environment.reset(options={"reset_mask": truncated})
    assert environment.step(none)[3].tolist() == [False, True, False]


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_it_draws_what_single_environments_draw(vector, mode):
    """Trails grow, and end where a scenario is restarted by its end or by a mask."""

    def limited():
        drawn = make_environment("avoidance", render_mode="rgb_array")
        return gymnasium.wrappers.TimeLimit(drawn, 12)

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
            for mine, its in zip(*(each.render() for each in both), strict=True):
                assert mine.dtype == np.uint8
                # Positions of two programs differ in their rounding, and pixels with them.
                assert np.mean(np.any(mine != its, axis=2)) < 1e-4
    assert not np.array_equal(ours.render()[1], before[1])


def test_gymnasium_makes_it_with_pictures():
    made = gymnasium.make_vec(NAME, num_envs=2, render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded):
        made.render()
    made.reset(seed=0)
    first, second = made.render()
    assert first.shape == second.shape
    assert not np.array_equal(first, second)
    silent = gymnasium.make_vec(NAME, num_envs=2)
    silent.reset(seed=0)
    assert silent.render() is None
    with pytest.raises(InputError, match=r"render_mode is human \(allowed: rgb_array\)"):
        gymnasium.make_vec(NAME, num_envs=2, render_mode="human")


def test_gymnasium_makes_it():
    made = gymnasium.make_vec(NAME, num_envs=4, autoreset_mode="SameStep")
    assert isinstance(made, VectorTaskEnvironment)
    assert made.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert made.reset(seed=0)[0] in made.observation_space


def test_every_action_of_the_table_can_be_given():
    environment = counted()
    environment.reset(seed=0)
    assert environment.step([0, 1, 2, np.int8(2)])[1].tolist() == [1.0, 11.0, 21.0, 21.0]


@pytest.mark.parametrize("actions", [[0, 0], [0, 0, 5], [0, 0, -1], [0.0, 0.0, 0.0]])
def test_actions_that_are_not_in_the_table_are_refused(vector, actions):
    environment = vector()
    environment.reset(seed=0)
    with pytest.raises(InputError, match="allowed: 3 whole numbers from 0 to 4"):
        environment.step(np.array(actions))


def test_what_cannot_be_is_refused(task, vector, types_unchecked):
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
