"""PPO with several agents: only the active ones are learnt from."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning import network, ppo
from skystack.learning.advantages import Transitions, compute_gae
from skystack.learning.collection import collect, draw
from skystack.learning.settings import PPOSettings
from skystack.tasks.contract import Metric, Outcome

AGENTS, ENVIRONMENTS, STEPS = 3, 4, 8
SETTINGS = PPOSettings(
    environments=ENVIRONMENTS, steps=STEPS, epochs=2, minibatch=8, hidden=(8,), learning_rate=3e-3
)


class Signs(NamedTuple):
    """A number for each agent, whose sign its action is to tell; its size says whether it acts."""

    number: jax.Array
    key: jax.Array


class TellSigns:
    """Agent 0 of each scenario is never active. The others are, half of the time."""

    name, version, agents = "signs", 1, AGENTS
    action_names = ("negative", "positive")
    observation_names = ("number",)
    metrics = {"right": Metric("share", "right answers")}  # noqa: RUF012

    def reset(self, key):
        return Signs(jax.random.uniform(key, (AGENTS,)), jax.random.key_data(key))

    def observe(self, state):
        return state.number[None]

    def active(self, state):
        numbers = jnp.arange(AGENTS).reshape(-1, *(1,) * (state.number.ndim - 1))
        return (numbers > 0) & (jnp.abs(state.number - 0.5) < 0.25)

    def waiting(self, state):
        return jnp.zeros_like(self.active(state))

    def instruct(self, state, action):
        return state

    def may_stack(self, state, action):
        return jnp.zeros_like(action, dtype=bool)

    def step(self, state, action):
        right = (state.number > 0.5) == (action == 1)
        reward = jnp.where(right, 1.0, -1.0)
        # Inactive agents are paid for being wrong, which must not matter.
        reward = jnp.where(self.active(state), reward, -5.0 * reward)
        number = jnp.mod(state.number * 7.31 + 0.123, 1.0)
        ended = jnp.zeros(state.number.shape[1:], dtype=bool)
        everyone = jnp.ones_like(state.number, dtype=bool)
        metrics = {"right": jnp.mean(right.astype(jnp.float32), axis=0)}
        return state._replace(number=number), Outcome(reward, everyone, ~everyone, ended, metrics)

    def advance(self, state):
        return self.step(state, jnp.zeros(state.number.shape, dtype=jnp.int32))


@pytest.mark.slow
def test_every_agent_of_every_environment_is_a_column():
    learner = ppo.init(TellSigns(), SETTINGS, jax.random.key(0))
    assert learner.observations.shape == (1, AGENTS * ENVIRONMENTS)
    _, transitions, _ = collect(
        TellSigns(), SETTINGS, learner, draw(TellSigns(), SETTINGS, learner)
    )
    assert transitions.action.shape == (STEPS, AGENTS * ENVIRONMENTS)
    active = np.asarray(transitions.active).reshape(STEPS, AGENTS, ENVIRONMENTS)
    assert not active[:, 0].any()
    assert active[:, 1:].any()
    number = np.asarray(transitions.observation)[:, 0].reshape(STEPS, AGENTS, ENVIRONMENTS)
    action = np.asarray(transitions.action).reshape(number.shape)
    right = np.where((number > 0.5) == (action == 1), 1.0, -1.0)
    expected = np.where(active, right, -5.0 * right) * SETTINGS.reward_scale
    np.testing.assert_allclose(
        np.asarray(transitions.reward).reshape(number.shape), expected, rtol=1e-6
    )


@pytest.mark.slow
def test_the_shared_policy_learns_from_the_active_agents_only():
    settings = PPOSettings(
        environments=16, steps=32, epochs=4, minibatch=64, hidden=(16,), learning_rate=3e-3,
        reward_scale=1.0, entropy=0.0,
    )  # fmt: skip
    task = TellSigns()
    learner = jax.jit(lambda key: ppo.init(task, settings, key))(jax.random.key(0))
    update = jax.jit(lambda learner: ppo.update(task, settings, learner))
    for _ in range(40):
        learner, measured = update(learner)
    assert all(np.isfinite(float(measured[name])) for name in ppo.LOSSES)
    observation = jnp.asarray([[0.3, 0.4, 0.6, 0.7]])
    normalised = ppo.normalise(learner.normaliser, observation, columns=True)
    chosen = np.argmax(
        np.asarray(ppo.forward(learner.parameters.actor, normalised, columns=True)), axis=0
    )
    assert chosen.tolist() == [0, 0, 1, 1]


@pytest.mark.slow
def test_what_inactive_agents_see_and_get_does_not_matter():
    task = TellSigns()
    learner = ppo.init(task, SETTINGS, jax.random.key(0))
    rng = np.random.default_rng(0)
    samples = AGENTS * ENVIRONMENTS * STEPS
    active = jnp.asarray(rng.random(samples) < 0.5)
    batch = jnp.asarray(rng.normal(size=(1 + ppo._EXTRA_ROWS, samples)), dtype=jnp.float32)
    batch = batch.at[1].set(jnp.asarray(rng.integers(0, 2, samples), dtype=jnp.float32))
    other = jnp.where(active[None], batch, batch * 3.0 + 1.0)
    key = jax.random.key(2)
    results = [
        ppo.learn(SETTINGS, learner, each, key, active=active, agents=AGENTS)[0].parameters
        for each in (batch, other)
    ]
    for one, two in zip(*map(jax.tree.leaves, results), strict=True):
        np.testing.assert_array_equal(one, two)
    normalisers = [
        network.update_normaliser(learner.normaliser, each[:1], active) for each in (batch, other)
    ]
    np.testing.assert_allclose(normalisers[0].mean, normalisers[1].mean)
    np.testing.assert_allclose(
        normalisers[0].mean[0], np.asarray(batch[0])[np.asarray(active)].mean(), atol=1e-2
    )


@pytest.mark.slow
def test_losses_are_means_over_the_gradient_steps():
    task = TellSigns()
    learner = ppo.init(task, SETTINGS, jax.random.key(0))
    rng = np.random.default_rng(3)
    samples = AGENTS * ENVIRONMENTS * STEPS
    batch = jnp.asarray(rng.normal(size=(1 + ppo._EXTRA_ROWS, samples)), dtype=jnp.float32)
    batch = batch.at[1].set(0.0)
    some = jnp.arange(samples) < 24  # three minibatches
    key = jax.random.key(1)
    few = ppo.learn(SETTINGS, learner, batch[:, :24], key)[1]
    masked = ppo.learn(SETTINGS, learner, batch, key, active=some, agents=AGENTS)[1]
    assert float(masked["value_loss"]) == pytest.approx(float(few["value_loss"]), rel=0.1)
    broken = batch.at[0, 3].set(jnp.nan)
    losses = ppo.learn(SETTINGS, learner, broken, key, active=some, agents=AGENTS)[1]
    assert not np.isfinite(float(losses["policy_loss"]))


def test_passing_over_minibatches_lowers_the_learning_rate_all_the_same():
    task = TellSigns()
    learner = ppo.init(task, SETTINGS, jax.random.key(0))
    batch = jnp.zeros((1 + ppo._EXTRA_ROWS, AGENTS * ENVIRONMENTS * STEPS))
    nobody = jnp.zeros(batch.shape[1], dtype=bool)
    after, losses = ppo.learn(
        SETTINGS, learner, batch, jax.random.key(1), active=nobody, agents=AGENTS
    )
    for one, two in zip(*map(jax.tree.leaves, (learner.parameters, after.parameters)), strict=True):
        np.testing.assert_array_equal(one, two)
    counts = [int(leaf) for leaf in jax.tree.leaves(after.optimiser) if leaf.dtype == jnp.int32]
    steps = SETTINGS.epochs * (batch.shape[1] // SETTINGS.minibatch)
    assert counts == [steps] * len(counts)
    assert {float(value) for value in losses.values()} == {0.0}


def test_advantages_do_not_cross_a_cycle_without_an_agent():
    column = lambda values, kind: jnp.asarray(values, dtype=kind)[:, None]  # noqa: E731
    empty = jnp.zeros((4, 1))
    steps = Transitions(
        observation=empty[:, :, None],
        final_observation=empty[:, :, None],
        action=empty.astype(jnp.int32),
        log_probability=empty,
        reward=column([1.0, 7.0, 7.0, 2.0], jnp.float32),
        terminated=column([True, False, False, False], bool),
        truncated=column([False] * 4, bool),
        active=column([True, False, False, True], bool),
        waiting=column([False] * 4, bool),
    )
    values = jnp.full((4, 1), 0.5)
    found = compute_gae(steps, values, values, PPOSettings(gamma=0.9, gae_lambda=0.8))
    assert float(found[0, 0]) == pytest.approx(1.0 - 0.5)
    assert float(found[3, 0]) == pytest.approx(2.0 + 0.9 * 0.5 - 0.5)


def test_advantages_pass_by_steps_in_which_an_agent_waits():
    """Two steps in frozen time, then two cycles. The agent decides in the first and last step."""
    empty = jnp.zeros((4, 1))
    column = lambda *values: jnp.asarray(values, dtype=bool)[:, None]  # noqa: E731
    steps = Transitions(
        observation=empty[:, :, None],
        final_observation=empty[:, :, None],
        action=empty.astype(jnp.int32),
        log_probability=empty,
        reward=jnp.asarray([0.0, 0.0, 3.0, 5.0])[:, None],
        terminated=column(False, False, False, True),
        truncated=column(False, False, False, False),
        time_steps=jnp.asarray([0.0, 0.0, 1.0, 1.0])[:, None],
        active=column(True, False, False, True),
        waiting=column(False, True, True, False),
    )
    values = jnp.asarray([0.5, 0.25, 0.75, 1.0])[:, None]
    following = jnp.asarray([0.25, 0.75, 1.0, 9.0])[:, None]
    found = compute_gae(steps, values, following, PPOSettings(gamma=0.9, gae_lambda=0.8))
    last = 5.0 - 1.0
    # Errors of value while waiting cancel: what remains is the reward and the value after it.
    second = 3.0 + 0.9 * 1.0 - 0.25 + 0.9 * last
    assert float(found[3, 0]) == pytest.approx(last)
    assert float(found[1, 0]) == pytest.approx(second)
    assert float(found[0, 0]) == pytest.approx(0.25 - 0.5 + 0.8 * second)


@pytest.mark.slow
def test_values_are_those_of_the_agents_that_are_there():
    """Values of present agents before each step, and of the final observation if truncated."""
    task, settings = TellSigns(), SETTINGS
    learner = ppo.init(task, settings, jax.random.key(0))
    _, steps, _ = collect(task, settings, learner, draw(task, settings, learner))
    truncated = jnp.zeros_like(steps.truncated).at[2, 5].set(True)
    steps = steps._replace(
        truncated=truncated, final_observation=steps.final_observation.at[2, :, 5].set(0.9)
    )

    def value(observation):
        columns = ppo.normalise(learner.normaliser, observation, columns=True)
        return np.asarray(ppo.forward(learner.parameters.critic, columns, columns=True)[0])

    values, following = map(np.asarray, ppo.compute_values(learner, steps))
    active = np.asarray(steps.active)
    expected = np.stack([value(row) for row in steps.observation])
    np.testing.assert_allclose(values, np.where(active, expected, 0.0), atol=1e-6)
    assert following[2, 5] == pytest.approx(value(jnp.asarray([[0.9]]))[0], abs=1e-6)
    np.testing.assert_allclose(following[1], values[2], atol=1e-6)
