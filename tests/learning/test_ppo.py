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
from skystack.tasks.build import build_task
from skystack.tasks.contract import Metrics, Outcome
from skystack.tasks.settings import TaskSettings

GAMMA, LAMBDA, STEPS = 0.9, 0.8, 12
SETTINGS = PPOSettings(gamma=GAMMA, gae_lambda=LAMBDA, steps=STEPS, environments=1, minibatch=1)


def steps_with(rewards, terminated, truncated):
    empty = jnp.zeros((STEPS, 1))
    column = lambda values, kind: jnp.asarray(values, dtype=kind)[:, None]  # noqa: E731
    return ppo.Steps(
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
    found = ppo.generalised_advantages(steps, jnp.full((STEPS, 1), value), next_values, SETTINGS)[
        :, 0
    ]

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
    found = ppo.generalised_advantages(
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
    np.testing.assert_array_equal(network.normalise_columns(normaliser, rows.T), normal.T)
    np.testing.assert_allclose(
        network.forward_columns(parameters.actor, normal.T),
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
    drawn = ppo.draw(
        jnp.broadcast_to(jnp.asarray(logarithms)[:, None], (5, 1000)), jnp.float32(lottery)
    )
    assert np.bincount(drawn, minlength=5).tolist() == [100, 0, 500, 150, 250]
    assert (np.diff(drawn) >= 0).all()


@pytest.mark.parametrize("cut_short", [False, True])
def test_the_value_after_a_step_is_of_its_own_scenario(cut_short):
    """Of the next observation, but where the scenario was cut short of its final one."""
    settings, task = PPOSettings(environments=1, steps=STEPS), build_task(TaskSettings())
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

    columns = network.normalise_columns(learner.normaliser, seen[:, :, 0].T)
    values, next_values = ppo.judge(learner, steps, columns)
    np.testing.assert_allclose(values, value(seen), atol=1e-5)
    np.testing.assert_allclose(next_values, value(final), atol=1e-5)


def test_the_first_policy_is_nearly_uniform():
    seen = jnp.asarray(np.random.default_rng(0).normal(size=(50, 8)), dtype=jnp.float32)
    plain = network.init(jax.random.key(0), 8, (64, 64), 5)
    assert float(jnp.max(jnp.abs(inference.forward(plain.actor, seen)))) < 0.1


class SignState(NamedTuple):
    value: jax.Array
    step: jax.Array


class SignTask:
    """Say 1 when the number shown is above a half, else 0: reward 1 for right; five steps."""

    name, version = "sign", 1
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
    no, zero = jnp.zeros((), dtype=bool), jnp.zeros(())
    metrics = Metrics(ended, no, no, no, zero, zero, zero, zero)
    return Outcome(reward, ended, no, metrics)


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
    settings, task = PPOSettings(environments=4, steps=8, minibatch=8), build_task(TaskSettings())
    before = ppo.init(task, settings, jax.random.key(0))
    after, _ = jax.eval_shape(lambda learner: ppo.update(task, settings, learner), before)

    def types(learner):
        leaves = jax.tree.leaves(learner._replace(key=None))
        return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in leaves]

    assert types(before) == types(after)
