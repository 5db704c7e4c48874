"""PPO: advantages in closed form, the normaliser, learning on a task whose answer is known."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.learning import inference, network, ppo
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import OneByOne
from skystack.tasks.contract import Metric, Outcome
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

GAMMA, LAMBDA, STEPS = 0.9, 0.8, 12
SETTINGS = PPOSettings(gamma=GAMMA, gae_lambda=LAMBDA, steps=STEPS, environments=1, minibatch=1)


def steps_with(rewards, terminated, truncated):
    empty = jnp.zeros((STEPS, 1))
    column = lambda values, kind: jnp.asarray(values, dtype=kind)[:, None]  # noqa: E731
    return ppo.Transitions(
        observation=empty[:, :, None],
        final_observation=empty[:, :, None],
        action=empty.astype(jnp.int32),
        log_probability=empty,
        reward=column(rewards, jnp.float32),
        terminated=column(terminated, bool),
        truncated=column(truncated, bool),
    )


@pytest.mark.parametrize("kind", ["terminated", "truncated"])
@pytest.mark.parametrize("end", range(STEPS))
def test_advantages_with_a_time_limit_at_every_position(end, kind):
    """Constant reward 1 and value v: every error is 1 + gamma v' - v, summed geometrically."""
    value, final_value = 2.0, 5.0
    at_end = np.arange(STEPS) == end
    never = np.zeros(STEPS, dtype=bool)
    steps = steps_with(
        np.ones(STEPS),
        at_end if kind == "terminated" else never,
        at_end if kind == "truncated" else never,
    )
    next_values = jnp.asarray(np.where(at_end, final_value, value), dtype=jnp.float32)[:, None]
    found = ppo.compute_gae(steps, jnp.full((STEPS, 1), value), next_values, SETTINGS)[:, 0]

    inner = 1.0 + GAMMA * value - value
    last = 1.0 - value + (0.0 if kind == "terminated" else GAMMA * final_value)
    decay = GAMMA * LAMBDA
    for step in range(STEPS):
        if step <= end:
            before = end - step
            expected = inner * (1 - decay**before) / (1 - decay) + decay**before * last
        else:
            expected = inner * (1 - decay ** (STEPS - step)) / (1 - decay)
        assert float(found[step]) == pytest.approx(expected, rel=1e-5)


def test_with_lambda_one_advantages_are_returns_minus_values():
    rng = np.random.default_rng(1)
    rewards, values = rng.normal(size=STEPS), rng.normal(size=STEPS)
    next_values = np.append(values[1:], 0.7)
    settings = PPOSettings(gamma=GAMMA, gae_lambda=1.0, steps=STEPS, environments=1, minibatch=1)
    never = np.zeros(STEPS, dtype=bool)
    found = ppo.compute_gae(
        steps_with(rewards, never, never),
        jnp.asarray(values, dtype=jnp.float32)[:, None],
        jnp.asarray(next_values, dtype=jnp.float32)[:, None],
        settings,
    )
    returns, expected = 0.7, []
    for reward in rewards[::-1]:
        returns = reward + GAMMA * returns
        expected.append(returns)
    np.testing.assert_allclose(found[:, 0], np.array(expected[::-1]) - values, rtol=1e-4, atol=1e-5)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=5), st.integers(0, 1000))
def test_the_normaliser_knows_mean_and_variance_of_all_it_saw(sizes, seed):
    rng = np.random.default_rng(seed)
    batches = [rng.normal(3.0, 2.0, size=(size, 2)).astype(np.float32) for size in sizes]
    normaliser = network.initial_normaliser(2)._replace(count=jnp.asarray(0.0))
    for batch in batches:
        normaliser = network.update_normaliser(normaliser, jnp.asarray(batch.T))
    everything = np.concatenate(batches)
    np.testing.assert_allclose(normaliser.mean, everything.mean(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(normaliser.variance, everything.var(axis=0), rtol=1e-3, atol=1e-4)


def test_numpy_and_jax_compute_the_same_network():
    parameters = network.init(jax.random.key(0), 8, (64, 64), 5)
    seen = np.random.default_rng(0).uniform(size=(100, 8)).astype(np.float32)
    in_jax = inference.forward(parameters.actor, jnp.asarray(seen))
    in_numpy = inference.forward(jax.device_get(parameters.actor), seen)
    assert isinstance(in_numpy, np.ndarray)
    np.testing.assert_allclose(in_jax, in_numpy, atol=1e-5)


def test_samples_may_be_rows_or_columns():
    parameters = network.init(jax.random.key(0), 8, (64, 64), 5)
    normaliser = inference.Normaliser(jnp.arange(8.0) / 8.0, jnp.full(8, 0.3), jnp.ones(()))
    rows = jnp.asarray(np.random.default_rng(0).uniform(size=(100, 8)), dtype=jnp.float32)
    normal = inference.normalise(normaliser, rows)
    np.testing.assert_array_equal(inference.normalise(normaliser, rows.T, columns=True), normal.T)
    np.testing.assert_allclose(
        inference.forward(parameters.actor, normal.T, columns=True),
        inference.forward(parameters.actor, normal).T,
        atol=1e-5,
    )


@pytest.mark.parametrize("count", [1, 2, 7, 64, 1000])
def test_shuffling_moves_every_number_anywhere(count):
    orders = np.array([ppo.shuffled(jax.random.key(seed), count) for seed in range(60)])
    assert (np.sort(orders, axis=1) == np.arange(count)).all()
    if count > 1:
        assert len(np.unique(orders, axis=0)) > 1
    if count == 1000:
        # The mean place of a number is that of a uniform one: deviation sqrt(1/12 / 60) = 0.037.
        assert np.abs(orders.mean(axis=0) / 999 - 0.5).max() < 5 * 0.037


def test_actions_are_drawn_by_their_probability():
    """At every point of the lottery the action in whose share of [0, 1) it lies."""
    shares = np.array([0.1, 0.0, 0.5, 0.15, 0.25])
    lottery = (np.arange(1000) + 0.5) / 1000
    logarithms = np.log(np.maximum(shares, 1e-30), dtype=np.float32)
    drawn = ppo.sample_actions(
        jnp.broadcast_to(jnp.asarray(logarithms)[:, None], (5, 1000)), jnp.float32(lottery)
    )
    assert np.bincount(drawn, minlength=5).tolist() == [100, 0, 500, 150, 250]
    assert (np.diff(drawn) >= 0).all()


@pytest.mark.parametrize("cut_short", [False, True])
def test_the_value_after_a_step_is_of_its_own_scenario(cut_short):
    """Of the next observation, but where the scenario was cut short of its final one."""
    settings, task = PPOSettings(environments=1, steps=STEPS), build_task(NavigationSettings())
    learner = ppo.init(task, settings, jax.random.key(0))
    rng = np.random.default_rng(0)
    seen = jnp.asarray(rng.uniform(size=(STEPS, 8, 1)), dtype=jnp.float32)
    final = seen.at[:-1].set(seen[1:]).at[-1].set(learner.observations)
    final = final.at[4].set(0.25) if cut_short else final
    ended = np.arange(STEPS) == 4
    steps = steps_with(np.zeros(STEPS), ended & (not cut_short), ended & cut_short)
    steps = steps._replace(observation=seen, final_observation=final)

    def value(observation):
        rows = inference.normalise(learner.normaliser, observation[..., 0])
        return inference.forward(learner.parameters.critic, rows)

    columns = inference.normalise(learner.normaliser, seen[:, :, 0].T, columns=True)
    values, next_values = ppo.compute_values(learner, steps, columns)
    np.testing.assert_allclose(values, value(seen), atol=1e-5)
    np.testing.assert_allclose(next_values, value(final), atol=1e-5)


def test_the_first_policy_is_nearly_uniform():
    seen = jnp.asarray(np.random.default_rng(0).normal(size=(50, 8)), dtype=jnp.float32)
    plain = network.init(jax.random.key(0), 8, (64, 64), 5)
    assert float(jnp.max(jnp.abs(inference.forward(plain.actor, seen)))) < 0.1


class SignState(NamedTuple):
    value: jax.Array
    step: jax.Array


METRICS = {"success": Metric("true or false", "the last answer")}


class SignTask:
    """Say 1 when the number shown is above a half, else 0: reward 1 for right; five steps."""

    name, version, agents = "sign", 1, 1
    metrics = METRICS
    action_names, observation_names = ("low", "high"), ("number",)

    def reset(self, key):
        return SignState(jax.random.uniform(key), jnp.zeros((), dtype=jnp.int32))

    def observe(self, state):
        return state.value[None]

    def instruct(self, state, action):
        return state

    def may_stack(self, state, action):
        return jnp.zeros((), dtype=bool)

    def step(self, state, action):
        right = (state.value > 0.5) == (action == 1)
        moved = SignState(jnp.mod(state.value * 7.3 + 0.31, 1.0), state.step + 1)
        return moved, outcome(right.astype(jnp.float32), moved.step >= 5)

    def advance(self, state):
        return self.step(state, jnp.zeros((), dtype=jnp.int32))


def outcome(reward, ended):
    no = jnp.zeros((), dtype=bool)
    return Outcome(reward[None], ended[None], no[None], ended, {"success": ended})


def learn_sign(seed):
    settings = PPOSettings(
        total_steps=20_000,
        learning_rate=3e-3,
        environments=16,
        steps=32,
        minibatch=64,
        epochs=4,
        reward_scale=1.0,
    )
    task = OneByOne(SignTask())
    learner = ppo.init(task, settings, jax.random.key(seed))
    update = jax.jit(lambda state: ppo.update(task, settings, state))
    measured = []
    for _ in range(settings.updates):
        learner, values = update(learner)
        measured.append(float(values["return"]))
    return learner, measured


def test_ppo_learns_a_task_with_a_known_answer():
    """Guessing earns 2.5 of 5, the right answer 5."""
    _, returns = learn_sign(seed=0)
    assert returns[0] == pytest.approx(2.5, abs=0.6)
    assert np.mean(returns[-5:]) > 4.7


def test_the_same_seed_twice_gives_the_same_policy_bit_for_bit():
    first, second, other = learn_sign(0)[0], learn_sign(0)[0], learn_sign(1)[0]
    for a, b in zip(
        jax.tree.leaves(first.parameters), jax.tree.leaves(second.parameters), strict=True
    ):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    assert not np.array_equal(first.parameters.actor[0][0], other.parameters.actor[0][0])


def test_an_update_is_compiled_once():
    """What comes out has the types of what went in, weak ones too, or JAX compiles again."""
    settings, task = (
        PPOSettings(environments=4, steps=8, minibatch=8),
        build_task(NavigationSettings()),
    )
    before = ppo.init(task, settings, jax.random.key(0))
    after, _ = jax.eval_shape(lambda learner: ppo.update(task, settings, learner), before)

    def types(learner):
        leaves = jax.tree.leaves(learner._replace(key=None))
        return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in leaves]

    assert types(before) == types(after)


def test_the_learning_rate_falls_linearly_over_all_gradient_steps():
    """Two updates of three epochs of four minibatches; a constant gradient moves by the rate."""
    settings = PPOSettings(
        total_steps=32,
        environments=2,
        steps=8,
        minibatch=4,
        epochs=3,
        learning_rate=0.1,
        final_learning_rate=0.25,
    )
    adam, gradient = ppo.optimiser(settings), jnp.asarray([0.2, -0.3])
    state, moved = adam.init(gradient), []
    for _ in range(26):
        with jax.numpy_dtype_promotion("standard"):
            change, state = adam.update(gradient, state)
        moved.append(change)
    rate = 0.1 * np.maximum(1.0 - 0.75 * np.arange(26) / 24, 0.25)
    np.testing.assert_allclose(moved, np.outer(rate, [-1.0, 1.0]), rtol=2e-4)


def test_a_minibatch_of_more_than_all_samples_is_one_an_epoch():
    settings = PPOSettings(
        total_steps=8, environments=2, steps=4, minibatch=9, epochs=2, final_learning_rate=0.0
    )
    adam, gradient = ppo.optimiser(settings), jnp.asarray([1.0])
    state, moved = adam.init(gradient), []
    for _ in range(3):
        with jax.numpy_dtype_promotion("standard"):
            change, state = adam.update(gradient, state)
        moved.append(float(change[0]))
    assert moved == pytest.approx([-1e-4, -0.5e-4, 0.0], rel=1e-3)


def linear_parameters(rng, observation=3, actions=4):
    def layer(outputs):
        weights = rng.normal(size=(observation, outputs))
        return ((jnp.float32(weights), jnp.float32(rng.normal(size=outputs))),)

    return network.Parameters(layer(actions), layer(1))


def minibatch_of(rng, samples, observation=3, actions=4):
    rows = rng.normal(size=(observation + 4, samples))
    rows[observation] = rng.integers(0, actions, samples)
    rows[observation + 1] = -rng.uniform(0.5, 2.0, samples)
    return rows


def test_the_loss_is_that_of_the_paper_on_ppo():
    """Clipped surrogate of normalised advantages, value error, entropy; float64."""
    rng = np.random.default_rng(2)
    settings = PPOSettings(clip=0.3, value_coefficient=0.7, entropy=0.05)
    parameters, rows = linear_parameters(rng), minibatch_of(rng, 50)
    total, parts = ppo.loss(parameters, jnp.asarray(rows, dtype=jnp.float32), settings)

    seen, (action, old, advantage, target) = rows[:3].T, rows[3:]
    ((weights, biases),) = parameters.actor
    scores = seen @ np.float64(weights) + np.float64(biases)
    shares = np.exp(scores) / np.exp(scores).sum(axis=1, keepdims=True)
    entropy = -np.mean(np.sum(shares * np.log(shares), axis=1))
    change = np.log(shares[np.arange(50), action.astype(int)]) - old
    ratio = np.exp(change)
    scaled = (advantage - advantage.mean()) / advantage.std()
    surrogate = [
        min(r * a, (0.7 if r < 0.7 else 1.3 if r > 1.3 else r) * a)
        for r, a in zip(ratio, scaled, strict=True)
    ]
    ((weights, biases),) = parameters.critic
    value = (seen @ np.float64(weights) + np.float64(biases))[:, 0]
    error = 0.5 * np.mean((value - target) ** 2)
    outside = np.mean((ratio < 0.7) | (ratio > 1.3))
    assert 0.2 < outside < 0.95
    expected = {
        "policy_loss": -np.mean(surrogate),
        "value_loss": error,
        "entropy": entropy,
        "kl": np.mean(ratio - 1.0 - change),
        "clip_fraction": outside,
    }
    assert {name: float(part) for name, part in parts.items()} == pytest.approx(expected, rel=1e-4)
    assert float(total) == pytest.approx(
        -np.mean(surrogate) + 0.7 * error - 0.05 * entropy, rel=1e-4
    )


@pytest.fixture(scope="module")
def linear_learner():
    return ppo.init(
        OneByOne(SignTask()), PPOSettings(environments=2, steps=2, hidden=()), jax.random.key(0)
    )


def test_a_gradient_step_is_one_of_adam_with_a_clipped_gradient(linear_learner):
    """The first of Adam moves by g / (|g| + epsilon) of the rate; one minibatch of everything."""
    rng = np.random.default_rng(4)
    settings = PPOSettings(
        environments=2,
        steps=10,
        minibatch=20,
        epochs=1,
        hidden=(),
        learning_rate=0.01,
        max_gradient_norm=0.3,
        adam_epsilon=0.5,
    )
    batch = jnp.asarray(minibatch_of(rng, 20, 1, 2), dtype=jnp.float32)
    before = linear_learner.parameters
    gradient = jax.grad(lambda parameters: ppo.loss(parameters, batch, settings)[0])(before)
    norm = np.sqrt(sum(np.sum(np.square(leaf)) for leaf in jax.tree.leaves(gradient)))
    assert norm > 0.3
    learner, losses = ppo.learn(settings, linear_learner, batch, jax.random.key(1))
    for old, new, slope in zip(
        *map(jax.tree.leaves, (before, learner.parameters, gradient)), strict=True
    ):
        clipped = np.asarray(slope) * 0.3 / norm
        np.testing.assert_allclose(
            new, old - 0.01 * clipped / (np.abs(clipped) + 0.5), rtol=1e-4, atol=1e-6
        )
    expected = ppo.loss(before, batch, settings)[1]
    np.testing.assert_allclose(losses["value_loss"], expected["value_loss"], rtol=1e-5)


@pytest.mark.parametrize(("minibatch", "steps_taken"), [(6, 9), (10, 6), (100, 3)])
def test_every_epoch_takes_each_whole_minibatch(linear_learner, minibatch, steps_taken):
    """Of 20 samples 3, 2 or 1, three times; what fills none is left out."""
    settings = PPOSettings(
        environments=2, steps=10, minibatch=minibatch, epochs=3, hidden=(), learning_rate=0.0001
    )
    rng = np.random.default_rng(4)
    batch = jnp.asarray(minibatch_of(rng, 20, 1, 2), dtype=jnp.float32)
    learner, _ = ppo.learn(settings, linear_learner, batch, jax.random.key(1))
    counts = {
        int(leaf)
        for leaf in jax.tree.leaves(learner.optimiser)
        if jnp.issubdtype(leaf.dtype, jnp.integer)
    }
    assert counts == {steps_taken}


COLLECTING = PPOSettings(
    environments=3, steps=12, minibatch=36, epochs=1, hidden=(4,), reward_scale=0.5
)


@pytest.fixture(scope="module")
def collected():
    """The learner before, with returns under way, the learner after, steps and episodes."""
    task = OneByOne(SignTask())
    learner = ppo.init(task, COLLECTING, jax.random.key(0))
    learner = learner._replace(returns=jnp.asarray([10.0, 20.0, 30.0]))
    after, steps, episodes = ppo.collect(task, COLLECTING, learner, jax.random.key(5))
    return learner, after, jax.tree.map(np.asarray, steps), episodes


def test_what_is_collected_is_what_happened(collected):
    """Scenarios of five steps: two end in twelve, and each end is followed by a fresh one."""
    before, after, steps, _ = collected
    seen, final = steps.observation[:, 0], steps.final_observation[:, 0]
    assert seen.shape == (12, 3)
    np.testing.assert_array_equal(seen[0], before.observations[0])
    np.testing.assert_allclose(final, np.mod(seen * 7.3 + 0.31, 1.0), atol=2e-6)
    ends = np.arange(12) % 5 == 4
    np.testing.assert_array_equal(steps.terminated, np.repeat(ends[:, None], 3, axis=1))
    assert not np.any(steps.truncated)
    np.testing.assert_array_equal(seen[1:][~ends[:-1]], final[:-1][~ends[:-1]])
    np.testing.assert_array_equal(seen[5], seen[10])
    assert np.all(seen[5] != final[4])
    np.testing.assert_array_equal(after.observations[0], final[-1])
    right = (seen > 0.5) == (steps.action == 1)
    np.testing.assert_array_equal(steps.reward, 0.5 * right)


def test_probabilities_are_those_of_the_policy_that_acted(collected):
    before, _, steps, _ = collected
    rows = inference.normalise(before.normaliser, steps.observation[:, 0].reshape(-1, 1))
    scores = np.asarray(inference.forward(before.parameters.actor, rows), dtype=np.float64)
    shares = np.exp(scores) / np.exp(scores).sum(axis=1, keepdims=True)
    taken = np.log(shares[np.arange(36), steps.action.reshape(-1)])
    np.testing.assert_allclose(steps.log_probability.reshape(-1), taken, atol=1e-5)


def test_returns_are_of_whole_scenarios(collected):
    """Unscaled; those that were under way count with what they had earned before."""
    _, after, steps, episodes = collected
    right = (steps.observation[:, 0] > 0.5) == (steps.action == 1)
    assert float(episodes.ended) == 6.0
    assert float(episodes.episode_return) == 60.0 + right[:10].sum()
    np.testing.assert_array_equal(after.returns, right[10:].sum(axis=0))
    assert float(episodes.metrics["success"]) == 6.0


class QuarterTask(SignTask):
    """Shows a quarter, always."""

    def observe(self, state):
        return jnp.full(1, 0.25)


def test_an_update_learns_from_what_it_collected():
    """The normaliser sees raw observations: 36 quarters beside a thousandth of a half."""
    task = OneByOne(QuarterTask())
    learner = ppo.init(task, COLLECTING, jax.random.key(0))
    after, measured = ppo.update(task, COLLECTING, learner)
    mean = (36.0 * 0.25 + 0.001 * 0.5) / 36.001
    assert float(after.normaliser.mean[0]) == pytest.approx(mean, abs=1e-6)
    assert float(after.normaliser.count) == pytest.approx(36.001)
    assert (int(learner.updates), int(after.updates)) == (0, 1)
    assert not jnp.array_equal(jax.random.key_data(after.key), jax.random.key_data(learner.key))
    # All is normalised as before the update: the critic learns from one standardised value.
    assert float(measured["episodes"]) == 6.0
    assert 0.0 <= float(measured["return"]) <= 5.0
    assert float(measured["success"]) == 1.0
    assert float(measured["clip_fraction"]) == 0.0  # nothing has changed before the only step
    assert float(measured["kl"]) == pytest.approx(0.0, abs=1e-6)
    for old, new in zip(*map(jax.tree.leaves, (learner.parameters, after.parameters)), strict=True):
        assert old.shape == new.shape
    assert not np.array_equal(learner.parameters.critic[-1][1], after.parameters.critic[-1][1])
