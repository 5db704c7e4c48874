"""`StackedEnvironment`: the clearances of `skystack.stacking.stack` in the loop of any agent."""

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.evaluation.evaluate import policy_task
from skystack.gym.environment import TaskEnvironment
from skystack.gym.registration import make_environment
from skystack.gym.stacked import StackedEnvironment, TwoPhaseEnvironment
from skystack.policies.shipped import find_policy
from skystack.stacking import stack
from skystack.tasks.settings import NavigationSettings, RewardSettings
from skystack.tasks.stacked_steps import StackedSteps
from tests.test_stacking import expected_counts


class Counter(gymnasium.Env):
    """Counts the instructions since the last cycle, at most seven. It does not use JAX."""

    observation_space = spaces.Box(0.0, np.inf, (2,), np.float32)
    action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.pending, self.cycles = (), 0
        return self.observe(), {}

    def observe(self):
        return np.array([len(self.pending), self.cycles], dtype=np.float32)

    def may_stack(self, action):
        return len(self.pending) < 7

    def instruct(self, action):
        self.pending = (*self.pending, action)

    def advance(self):
        reward = float(len(self.pending))
        self.pending, self.cycles = (), self.cycles + 1
        return reward, self.cycles == 5, False, {"cycles": self.cycles}

    def step(self, action):
        self.instruct(action)
        outcome = self.advance()
        return self.observe(), *outcome


@given(st.lists(st.integers(0, 3), min_size=9, max_size=9), st.integers(1, 9))
def test_compiles_the_same_clearances_as_stack(answers, limit):
    """For any sequence of actions, see `expected_counts`; action 0 is the no-op."""
    instructions, queries = expected_counts(answers, min(limit, 7))
    environment = StackedEnvironment(Counter(), limit)
    environment.reset()
    for number, action in enumerate(answers[:queries], 1):
        seen, reward, *_, info = environment.step(np.int64(action))
        flies = number == queries
        assert ("clearance" in info) == flies
        assert seen.tolist() == ([0, 1] if flies else [number, 0])
        assert reward == (instructions if flies else 0.0)
    issued = answers[0] if instructions else 0
    assert info["clearance"] == {"action": issued, "instructions": instructions}


def test_limit_ends_the_stack_of_a_constant_agent():
    environment = StackedEnvironment(Counter(), limit=3)
    environment.reset()
    infos = [environment.step(2)[-1] for _ in range(6)]
    clearance = {"action": 2, "instructions": 3}
    assert [info.get("clearance") for info in infos] == [None, None, clearance] * 2


def test_limit_of_one_steps_as_the_plain_environment():
    stacked, plain = StackedEnvironment(Counter(), limit=1), Counter()
    stacked.reset(), plain.reset()
    for action in (1, 1, 2, 3, 3):
        seen, *outcome, info = stacked.step(action)
        expected_seen, *expected, expected_info = plain.step(action)
        assert (seen.tolist(), outcome) == (expected_seen.tolist(), expected)
        assert info == expected_info | {"clearance": {"action": action, "instructions": 1}}


WRONG = [99, -1, 4, 2.5, 2.0, float("nan"), "x", None, [1], np.array([1]), 10**30]


@pytest.mark.parametrize("wrong", WRONG, ids=map(str, WRONG))
@pytest.mark.parametrize("before", [(), (1,), (1, 1)], ids=len)
def test_rejects_invalid_actions_at_every_step(before, wrong):
    """At the first and at all later steps; the state is unchanged and the scenario continues."""
    environment = StackedEnvironment(Counter())
    environment.reset()
    for action in before:
        environment.step(action)
    with pytest.raises(InputError, match=r"^action is .* \(allowed: Discrete\(4\)\)$"):
        environment.step(wrong)
    *_, info = environment.step(0)
    assert info["clearance"]["instructions"] == len(before)


BOX = spaces.Box(0.0, 0.1, (2,), np.float32)
BYTES = spaces.Box(0, 255, (1,), np.uint8)
ACTIONS = [
    (spaces.Discrete(4), [3, np.int8(3), np.array(3), np.uint64(3), jnp.int32(3)], [jnp.int32(4)]),
    (spaces.Discrete(2, start=5), [5, 6], [0, 1, 7]),
    (
        BOX,
        [np.array([0.1, 0.0]), [0.0, 0.05], np.float16([0.0, 0.0]), np.zeros(2, int)],
        [
            np.array([0.2, 0.0]),
            np.array([np.nan, 0.0]),
            np.zeros(3),
            [[0.0], [0.0, 0.0]],
            "x",
            1e300,
        ],
    ),
    (BYTES, [np.array([255]), [7]], [np.array([256]), np.array([-1]), np.array([1.0]), 7]),
    (spaces.MultiDiscrete([3, 2]), [[2, 1], np.uint8([0, 0])], [[3, 1], [2.0, 1.0], [1]]),
    (spaces.MultiBinary(2), [[True, False], np.array([0, 1])], [[2, 0], [1]]),
    (spaces.Text(3), ["left"[:3]], ["to the left", 5]),
]


@pytest.mark.parametrize(("space", "allowed", "rejected"), ACTIONS, ids=lambda each: str(each)[:12])
def test_actions_must_belong_to_the_action_space(space, allowed, rejected):
    """For spaces of any kind, and arrays of any library and precision."""

    class Other(Counter):
        action_space = space

    for action in allowed:
        environment = StackedEnvironment(Other(), no_op=-1)
        environment.reset()
        assert environment.step(action)[-1] == environment.step(action)[-1] == {}
    for action in rejected:
        environment = StackedEnvironment(Other(), no_op=-1)
        environment.reset()
        with pytest.raises(InputError, match="action is "):
            environment.step(action)
        environment.step(allowed[0])
        with pytest.raises(InputError, match="action is "):
            environment.step(action)


def test_arrays_may_be_overwritten_after_every_step():
    """The agent's action buffer, the returned clearance, and the array passed as no-op."""

    class Other(Counter):
        action_space = BOX

        def instruct(self, action):
            super().instruct(action.tolist())
            action[:] = 7.0

    no_op, buffer = np.zeros(2, dtype=np.float32), np.zeros(2, dtype=np.float32)
    environment = StackedEnvironment(Other(), no_op=no_op)
    environment.reset()
    no_op[:] = 7.0
    for _ in range(3):
        clearances = []
        for answer in ((0.05, 0.0), (0.05, 0.0), (0.0, 0.05), (0.0, 0.0)):
            buffer[:] = answer
            *_, info = environment.step(buffer)
            buffer[:] = 7.0
            if "clearance" in info:
                clearance = info["clearance"]
                clearances.append((clearance["action"].tolist(), clearance["instructions"]))
                clearance["action"][:] = 7.0
        assert clearances == [([np.float32(0.05), 0.0], 2), ([0.0, 0.0], 0)]


def test_reset_discards_an_unfinished_stack():
    environment = StackedEnvironment(Counter())
    environment.reset()
    environment.step(1)
    environment.reset()
    seen, *_, info = environment.step(2)
    assert (seen.tolist(), info) == ([1.0, 0.0], {})


def test_any_action_can_be_the_no_op():
    environment = StackedEnvironment(Counter(), no_op=3)
    environment.reset()
    assert environment.step(0)[-1] == {}
    clearance = environment.step(3)[-1]["clearance"]
    assert clearance == {"action": 0, "instructions": 1}
    assert environment.step(3)[-1]["clearance"] == {"action": 3, "instructions": 0}


class ConstantAgent:
    """An agent of Stable-Baselines3 that always returns the same action."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.ones(len(observation), dtype=np.int64), state


def test_works_with_stable_baselines3_evaluation():
    """Five cycles with seven instructions each; every instruction is rewarded with 1."""
    evaluation = pytest.importorskip("stable_baselines3.common.evaluation")
    monitor = pytest.importorskip("stable_baselines3.common.monitor").Monitor
    monitored = monitor(StackedEnvironment(Counter()))
    returns, steps = evaluation.evaluate_policy(
        ConstantAgent(), monitored, n_eval_episodes=2, return_episode_rewards=True
    )
    assert (returns, steps) == ([35.0, 35.0], [35, 35])


def test_rejects_wrappers_that_it_would_bypass():
    with pytest.raises(InputError, match="TimeLimit is inside StackedEnvironment"):
        StackedEnvironment(gymnasium.wrappers.TimeLimit(Counter(), 5))
    limited = gymnasium.wrappers.TimeLimit(StackedEnvironment(Counter()), 3)
    limited.reset()
    assert [limited.step(1)[3] for _ in range(3)] == [False, False, True]


def test_rejects_an_environment_without_two_phases():
    with pytest.raises(InputError, match="CartPoleEnv cannot be stacked: it lacks observe, may_st"):
        StackedEnvironment(gymnasium.make("CartPole-v1", max_episode_steps=-1))
    with pytest.raises(InputError, match="limit is 0"):
        StackedEnvironment(Counter(), limit=0)


@pytest.fixture(scope="module")
def policy():
    return find_policy("lateral-best")


@pytest.fixture(scope="module")
def environment(policy):
    return TaskEnvironment(policy_task(policy))


@pytest.mark.slow
def test_shipped_policy_issues_the_same_clearances_as_stack(policy, environment):
    """Over whole scenarios, with rewards and ends; stacking changes no physical state."""
    assert isinstance(environment, TwoPhaseEnvironment)
    stacked, plain = StackedEnvironment(environment), environment.programs
    stacks = 0
    for scenario in range(4):
        seen, _ = stacked.reset(seed=scenario)
        state, ended = plain.begin(environment.task_state), False
        while not ended:
            answers = []

            def recorded_policy(observation, answers=answers):
                answers.append(policy(observation))
                return answers[-1]

            state, expected = stack(plain, recorded_policy, state)
            before = environment.task_state
            for _ in answers[1:]:
                seen, reward, ended, *_, info = stacked.step(policy(seen))
                assert (reward, ended, info) == (0.0, False, {})
                instructed = environment.task_state
                for name in ("position_nm", "heading_deg", "level_ticks", "ground_speed_kt"):
                    assert np.array_equal(
                        getattr(instructed.traffic, name), getattr(before.traffic, name)
                    )
                assert instructed.memory.progress.cycles == before.memory.progress.cycles
            state, outcome = plain.advance(state)
            seen, reward, ended, _, info = stacked.step(policy(seen))
            issued = info["clearance"]
            assert issued["instructions"] == expected.instructions
            assert not expected.instructions or issued["action"] == expected.action
            assert (reward, ended) == (outcome.reward, outcome.ended)
            assert np.array_equal(seen, plain.observe(state))
            stacks += int(expected.instructions > 1)
        assert info["success"] == bool(outcome.metrics["success"])
    assert stacks >= 4


@pytest.mark.slow
def test_steps_as_the_training_task_with_stacked_steps():
    """Wrapping such an environment does not change its steps, including the burst penalties."""
    settings = NavigationSettings(timing="stack", reward=RewardSettings(burst=1.0))
    training = make_environment("lateral", settings)
    stacked = StackedEnvironment(make_environment("lateral", settings))
    assert isinstance(training.task, StackedSteps)
    training.reset(seed=1), stacked.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(120):
        action = rng.choice([0, 1, 1, 1, 4])
        seen, reward, *ends, _ = training.step(action)
        other_seen, other_reward, *other_ends, _ = stacked.step(action)
        np.testing.assert_allclose(other_seen, seen, atol=1e-6)
        assert other_reward == pytest.approx(reward, abs=1e-5)
        assert other_ends == ends
    cycles = training.task_state.inner.memory.progress.cycles
    assert 20.0 < float(cycles) < 100.0
