"""PPO: advantages in closed form, the normaliser, and learning a task with a known solution."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.learning import inference, network, ppo
from skystack.learning.advantages import Transitions, compute_gae
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import OneByOne
from skystack.tasks.contract import Metric, Outcome
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

GAMMA, LAMBDA, STEPS = 0.9, 0.8, 12
SETTINGS = PPOSettings(gamma=GAMMA, gae_lambda=LAMBDA, steps=STEPS, environments=1, minibatch=1)


def transitions(rewards, terminated, truncated):
    empty = jnp.zeros((STEPS, 1))
    column = lambda values, kind: jnp.asarray(values, dtype=kind)[:, None]  # noqa: E731
    return Transitions(
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
def test_advantages_with_an_episode_end_at_every_step(end, kind):
    """Reward 1 and a constant value v: the errors 1 + gamma v' - v are summed geometrically."""
    value, final_value = 2.0, 5.0
    at_end = np.arange(STEPS) == end
    never = np.zeros(STEPS, dtype=bool)
    steps = transitions(
        np.ones(STEPS),
        at_end if kind == "terminated" else never,
        at_end if kind == "truncated" else never,
    )
    next_values = jnp.asarray(np.where(at_end, final_value, value), dtype=jnp.float32)[:, None]
    found = compute_gae(steps, jnp.full((STEPS, 1), value), next_values, SETTINGS)[:, 0]

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


def test_advantages_are_returns_minus_values_if_lambda_is_one():
    rng = np.random.default_rng(1)
    rewards, values = rng.normal(size=STEPS), rng.normal(size=STEPS)
    next_values = np.append(values[1:], 0.7)
    settings = PPOSettings(gamma=GAMMA, gae_lambda=1.0, steps=STEPS, environments=1, minibatch=1)
    never = np.zeros(STEPS, dtype=bool)
    found = compute_gae(
        transitions(rewards, never, never),
        jnp.asarray(values, dtype=jnp.float32)[:, None],
        jnp.asarray(next_values, dtype=jnp.float32)[:, None],
        settings,
    )
    returns, expected = 0.7, []
    for reward in rewards[::-1]:
        returns = reward + GAMMA * returns
        expected.append(returns)
    np.testing.assert_allclose(found[:, 0], np.array(expected[::-1]) - values, rtol=1e-4, atol=1e-5)


def test_a_step_of_several_time_steps_is_worth_as_much_as_the_steps_in_it():
    """With lambda 1: rewards on steps 0, 3 and 4, the first of which takes three time steps."""
    rng = np.random.default_rng(2)
    never = np.zeros(STEPS, dtype=bool)
    rewards = np.where(np.isin(np.arange(STEPS), [1, 2]), 0.0, rng.normal(size=STEPS))
    zero = jnp.zeros((STEPS, 1))
    settings = PPOSettings(gamma=GAMMA, gae_lambda=1.0, steps=STEPS, environments=1, minibatch=1)
    plain = transitions(rewards, never, never)
    expected = compute_gae(plain, zero, zero, settings)[:, 0]
    merged = np.append(np.delete(rewards, [1, 2]), [0.0, 0.0])
    steps = transitions(merged, never, never)
    steps = steps._replace(time_steps=jnp.ones((STEPS, 1)).at[0].set(3.0))
    found = compute_gae(steps, zero, zero, settings)[:, 0]
    np.testing.assert_allclose(found[:-2], np.delete(expected, [1, 2]), rtol=1e-5)


@pytest.mark.slow
@given(st.lists(st.integers(1, 40), min_size=1, max_size=5), st.integers(0, 1000))
def test_normaliser_tracks_mean_and_variance_of_all_batches(sizes, seed):
    rng = np.random.default_rng(seed)
    batches = [rng.normal(3.0, 2.0, size=(size, 2)).astype(np.float32) for size in sizes]
    normaliser = network.initial_normaliser(2)._replace(count=jnp.asarray(0.0))
    for batch in batches:
        normaliser = network.update_normaliser(normaliser, jnp.asarray(batch.T))
    everything = np.concatenate(batches)
    np.testing.assert_allclose(normaliser.mean, everything.mean(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(normaliser.variance, everything.var(axis=0), rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_observations_are_left_alone_without_normalisation():
    settings = PPOSettings(
        environments=2,
        steps=8,
        minibatch=16,
        epochs=1,
        hidden=(),
        normalise_observations=False,
    )
    task = OneByOne(SignTask())
    begun = ppo.init(task, settings, jax.random.key(0))
    seen = jnp.asarray(np.random.default_rng(0).uniform(size=(5, 1)), dtype=jnp.float32)
    np.testing.assert_allclose(inference.normalise(begun.normaliser, seen), seen, rtol=1e-6)
    learned, _ = jax.jit(partial(ppo.update, task, settings))(begun)
    jax.tree.map(np.testing.assert_array_equal, learned.normaliser, begun.normaliser)


def test_numpy_and_jax_forward_passes_agree():
    parameters = network.init(jax.random.key(0), 8, (64, 64), 5)
    seen = np.random.default_rng(0).uniform(size=(100, 8)).astype(np.float32)
    in_jax = inference.forward(parameters.actor, jnp.asarray(seen))
    in_numpy = inference.forward(jax.device_get(parameters.actor), seen)
    assert isinstance(in_numpy, np.ndarray)
    np.testing.assert_allclose(in_jax, in_numpy, atol=1e-5)


def test_rows_and_columns_give_the_same_results():
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
def test_shuffling_is_a_uniform_permutation(count):
    orders = np.array([ppo.shuffled(jax.random.key(seed), count) for seed in range(60)])
    assert (np.sort(orders, axis=1) == np.arange(count)).all()
    if count > 1:
        assert len(np.unique(orders, axis=0)) > 1
    if count == 1000:
        # The mean position is that of a uniform variable: deviation sqrt(1/12 / 60) = 0.037.
        assert np.abs(orders.mean(axis=0) / 999 - 0.5).max() < 5 * 0.037


@pytest.mark.slow
@pytest.mark.parametrize("truncated", [False, True])
def test_next_values_belong_to_the_same_scenario(truncated):
    """The value of the next observation, or of the final one if the scenario was truncated."""
    settings, task = PPOSettings(environments=1, steps=STEPS), build_task(NavigationSettings())
    learner = ppo.init(task, settings, jax.random.key(0))
    rng = np.random.default_rng(0)
    seen = jnp.asarray(rng.uniform(size=(STEPS, 8, 1)), dtype=jnp.float32)
    final = seen.at[:-1].set(seen[1:]).at[-1].set(learner.observations)
    final = final.at[4].set(0.25) if truncated else final
    ended = np.arange(STEPS) == 4
    steps = transitions(np.zeros(STEPS), ended & (not truncated), ended & truncated)
    steps = steps._replace(observation=seen, final_observation=final)

    def value(observation):
        rows = inference.normalise(learner.normaliser, observation[..., 0])
        return inference.forward(learner.parameters.critic, rows)

    values, next_values = ppo.compute_values(learner, steps)
    np.testing.assert_allclose(values, value(seen), atol=1e-5)
    np.testing.assert_allclose(next_values, value(final), atol=1e-5)


def test_initial_policy_is_nearly_uniform():
    seen = jnp.asarray(np.random.default_rng(0).normal(size=(50, 8)), dtype=jnp.float32)
    initial = network.init(jax.random.key(0), 8, (64, 64), 5)
    assert float(jnp.max(jnp.abs(inference.forward(initial.actor, seen)))) < 0.1


class SignState(NamedTuple):
    value: jax.Array
    step: jax.Array


METRICS = {"success": Metric("true or false", "the last answer")}


class SignTask:
    """Five steps; the reward is 1 for action 1 if the observed number exceeds 1/2, else for 0."""

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
        correct = (state.value > 0.5) == (action == 1)
        next_state = SignState(jnp.mod(state.value * 7.3 + 0.31, 1.0), state.step + 1)
        return next_state, outcome(correct.astype(jnp.float32), next_state.step >= 5)

    def advance(self, state):
        return self.step(state, jnp.zeros((), dtype=jnp.int32))


def outcome(reward, ended):
    never = jnp.zeros((), dtype=bool)
    return Outcome(reward[None], ended[None], never[None], ended, {"success": ended})


def learn_sign(seed, head=None):
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
    learner = ppo.init(task, settings, jax.random.key(seed), head)
    update = jax.jit(lambda state: ppo.update(task, settings, state, head))
    measured = []
    for _ in range(settings.updates):
        learner, values = update(learner)
        measured.append(float(values["return"]))
    return learner, measured


@pytest.mark.slow
def test_learns_a_task_with_a_known_solution():
    """Guessing returns 2.5, always being correct 5."""
    _, returns = learn_sign(seed=0)
    assert returns[0] == pytest.approx(2.5, abs=0.6)
    assert np.mean(returns[-5:]) > 4.7


@pytest.mark.slow
def test_learns_with_logits_that_a_head_makes_of_the_outputs():
    """With the only output x, the logits are x and -x."""
    head = network.Head(1, lambda outputs: jnp.concatenate([outputs, -outputs]))
    learner, returns = learn_sign(seed=0, head=head)
    assert learner.parameters.actor[-1][1].shape == (1,)
    assert np.mean(returns[-5:]) > 4.7


@pytest.mark.slow
def test_equal_seeds_train_bit_identical_policies():
    first, second, other = learn_sign(0)[0], learn_sign(0)[0], learn_sign(1)[0]
    for a, b in zip(
        jax.tree.leaves(first.parameters), jax.tree.leaves(second.parameters), strict=True
    ):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    assert not np.array_equal(first.parameters.actor[0][0], other.parameters.actor[0][0])


@pytest.mark.slow
def test_update_is_compiled_once():
    """Output types equal input types, including weak types; otherwise JAX would compile again."""
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


def test_learning_rate_falls_linearly_over_gradient_steps():
    """Two updates of three epochs of four minibatches; a constant gradient steps by the rate."""
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
    state, changes = adam.init(gradient), []
    for _ in range(26):
        with jax.numpy_dtype_promotion("standard"):
            change, state = adam.update(gradient, state)
        changes.append(change)
    rate = 0.1 * np.maximum(1.0 - 0.75 * np.arange(26) / 24, 0.25)
    np.testing.assert_allclose(changes, np.outer(rate, [-1.0, 1.0]), rtol=2e-4)


def test_oversized_minibatch_means_one_step_per_epoch():
    settings = PPOSettings(
        total_steps=8, environments=2, steps=4, minibatch=9, epochs=2, final_learning_rate=0.0
    )
    adam, gradient = ppo.optimiser(settings), jnp.asarray([1.0])
    state, changes = adam.init(gradient), []
    for _ in range(3):
        with jax.numpy_dtype_promotion("standard"):
            change, state = adam.update(gradient, state)
        changes.append(float(change[0]))
    assert changes == pytest.approx([-1e-4, -0.5e-4, 0.0], rel=1e-3)


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


@pytest.mark.parametrize("normalise_advantages", [True, False])
def test_loss_agrees_with_the_ppo_paper(normalise_advantages):
    """Clipped surrogate of advantages, value error and entropy, in float64."""
    rng = np.random.default_rng(2)
    settings = PPOSettings(
        clip=0.3,
        value_coefficient=0.7,
        entropy=0.05,
        normalise_advantages=normalise_advantages,
    )
    parameters, rows = linear_parameters(rng), minibatch_of(rng, 50)
    total, parts = ppo.loss(parameters, jnp.asarray(rows, dtype=jnp.float32), settings)

    seen, (action, old, advantage, target) = rows[:3].T, rows[3:]
    ((weights, biases),) = parameters.actor
    scores = seen @ np.float64(weights) + np.float64(biases)
    probabilities = np.exp(scores) / np.exp(scores).sum(axis=1, keepdims=True)
    entropy = -np.mean(np.sum(probabilities * np.log(probabilities), axis=1))
    log_ratio = np.log(probabilities[np.arange(50), action.astype(int)]) - old
    ratio = np.exp(log_ratio)
    scaled = advantage
    if normalise_advantages:
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
        "kl": np.mean(ratio - 1.0 - log_ratio),
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


@pytest.mark.slow
def test_gradient_step_is_adam_with_a_clipped_gradient(linear_learner):
    """Adam's first step is the rate times g / (|g| + epsilon); one minibatch of all samples."""
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
def test_every_epoch_uses_all_full_minibatches(linear_learner, minibatch, steps_taken):
    """20 samples make 3, 2 or 1 minibatches, in three epochs; incomplete ones are dropped."""
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


class QuarterTask(SignTask):
    """The observation is always 1/4."""

    def observe(self, state):
        return jnp.full(1, 0.25)


@pytest.mark.slow
def test_update_learns_from_its_own_samples():
    """The normaliser sees raw observations: 36 of 1/4, and a prior of 1/2 with weight 0.001."""
    task = OneByOne(QuarterTask())
    learner = ppo.init(task, COLLECTING, jax.random.key(0))
    after, measured = ppo.update(task, COLLECTING, learner)
    mean = (36.0 * 0.25 + 0.001 * 0.5) / 36.001
    assert float(after.normaliser.mean[0]) == pytest.approx(mean, abs=1e-6)
    assert float(after.normaliser.count) == pytest.approx(36.001)
    assert (int(learner.updates), int(after.updates)) == (0, 1)
    assert not jnp.array_equal(jax.random.key_data(after.key), jax.random.key_data(learner.key))
    # Observations are normalised as before the update, so the critic sees one constant value.
    assert float(measured["episodes"]) == 6.0
    assert 0.0 <= float(measured["return"]) <= 5.0
    assert float(measured["success"]) == 1.0
    assert float(measured["clip_fraction"]) == 0.0  # measured before the only gradient step
    assert float(measured["kl"]) == pytest.approx(0.0, abs=1e-6)
    for old, new in zip(*map(jax.tree.leaves, (learner.parameters, after.parameters)), strict=True):
        assert old.shape == new.shape
    assert not np.array_equal(learner.parameters.critic[-1][1], after.parameters.critic[-1][1])
