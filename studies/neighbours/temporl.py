"""TempoRL with deep Q-networks (Biedenkapp et al. 2021, "TempoRL: Learning When to Act").

A first network estimates the values of actions, as in double DQN; a second one those of the number
of cycles for which the chosen action is repeated. The first learns from single cycles. The second
learns from runs of cycles inside repetitions, since a repetition contains all shorter ones: its
target is the discounted rewards of the run plus the first network's value after it.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.learning.experiment import Experiment
from skystack.learning.inference import Layers, Normaliser, forward, normalise
from skystack.learning.network import init_layers, initial_normaliser, update_normaliser
from skystack.learning.seeds import training_key
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import choose, reset_many
from skystack.tasks.contract import Task, TaskState
from skystack.tasks.observations import flatten_observation
from studies.neighbours.decisions import Decisions
from studies.neighbours.learner import Budget, Trained
from studies.neighbours.methods import MOST, Method, build

CYCLES = 64
"""Cycles of each environment between two rounds of gradient steps."""
REPLAY_CYCLES = 4096
"""Cycles of each environment in the replay memory."""
SAMPLES_PER_CYCLE = 10
"""How many times each cycle is sampled on average, about as often as in PPO."""
EXPLORED = 0.3
"""The share of the budget over which epsilon falls from 1 to `LEAST_RANDOM`."""
LEAST_RANDOM = 0.05
TARGET_RATE = 0.005
"""The rate of the soft update of the target networks, at each gradient step."""


class Networks(NamedTuple):
    """The values of actions, and of the lengths of their repetition."""

    action: Layers
    length: Layers


class Replay(NamedTuple):
    """The last cycles of all environments, as ring buffers along the first axis."""

    observation: Float[Array, "cycles environments observation"]
    action: Int[Array, "cycles environments"]
    reward: Float[Array, "cycles environments"]
    ended: Bool[Array, "cycles environments"]
    remaining: Int[Array, "cycles environments"]
    """The remaining cycles of the repetition; 0 in its last cycle."""
    following: Float[Array, "cycles environments observation"]
    """The observation after the cycle, before an ended scenario is replaced."""


class State(NamedTuple):
    """Everything that changes during training."""

    networks: Networks
    targets: Networks
    optimiser: optax.OptState
    normaliser: Normaliser
    scenarios: TaskState
    observations: Float[Array, "observation environments"]
    action: Int[Array, " environments"]
    remaining: Int[Array, " environments"]
    replay: Replay
    rounds: Int[Array, ""]
    key: PRNGKeyArray


def train(method: Method, experiment: Experiment, cycles: int, seed: int) -> Trained:
    """Train with the rewards of the experiment, without pre-training."""
    tasks, settings, budget = build(method, experiment), experiment.ppo, Budget()
    assert isinstance(tasks.trained, Decisions)
    task = tasks.trained.task
    state = jax.jit(partial(init, task, settings))(training_key(seed))
    rounds = cycles / (CYCLES * settings.environments)
    program = jax.jit(partial(one_round, task, settings, rounds * EXPLORED)).lower(state).compile()
    state = budget.spend(cycles, program, state)
    weights = state.networks, state.normaliser
    return Trained(decide, decide, weights, budget.good_after, budget.train_s)


def decide(
    weights: tuple[Networks, Normaliser], observation: Array, key: PRNGKeyArray
) -> Int[Array, ""]:
    """The best action and its best length, as one of `repetitions`."""
    networks, normaliser = weights
    normalised = normalise(normaliser, flatten_observation(observation))[None]
    action = jnp.argmax(forward(networks.action, normalised), axis=1)
    length = jnp.argmax(_lengths(networks, normalised, action), axis=1)
    return (action * MOST + length)[0].astype(jnp.int32)


def _lengths(
    networks: Networks, normalised: Float[Array, "n observation"], action: Int[Array, " n"]
) -> Float[Array, "n lengths"]:
    actions = networks.action[-1][1].shape[0]
    values: Float[Array, "n lengths"] = forward(
        networks.length, jnp.concatenate([normalised, jax.nn.one_hot(action, actions)], axis=1)
    )
    return values


def init(task: Task, settings: PPOSettings, key: PRNGKeyArray) -> State:
    """Random networks, new scenarios and an empty replay memory."""
    action_key, length_key, scenario_key, key = jax.random.split(key, 4)
    size, actions = len(task.observation_names), len(task.action_names)
    networks = Networks(
        init_layers(action_key, (size, *settings.hidden, actions), last_gain=0.01),
        init_layers(length_key, (size + actions, *settings.hidden, MOST), last_gain=0.01),
    )
    scenarios = reset_many(task, scenario_key, settings.environments)
    shape = (REPLAY_CYCLES, settings.environments)
    zeros = jnp.zeros(settings.environments, dtype=jnp.int32)
    observation = jnp.zeros((*shape, size))
    nothing, no = jnp.zeros(shape, dtype=jnp.int32), jnp.zeros(shape, dtype=bool)
    return State(
        networks,
        networks,
        _optimiser(settings).init(networks),
        initial_normaliser(size),
        scenarios,
        flatten_observation(task.observe(scenarios), batch_axes=1),
        zeros,
        zeros,
        Replay(observation, nothing, jnp.zeros(shape), no, nothing, observation),
        jnp.zeros((), dtype=jnp.int32),
        key,
    )


def _optimiser(settings: PPOSettings) -> optax.GradientTransformation:
    return optax.chain(
        optax.clip_by_global_norm(10.0),
        optax.adam(settings.learning_rate, eps=settings.adam_epsilon),
    )


def one_round(
    task: Task, settings: PPOSettings, exploring_rounds: float, state: State
) -> tuple[State, dict[str, Array]]:
    """Fly `CYCLES` cycles in each environment, then learn. To be compiled."""
    key, collect_key, learn_key = jax.random.split(state.key, 3)
    state = state._replace(key=key)
    fallen = jnp.minimum(state.rounds.astype(jnp.float32) / exploring_rounds, 1.0)
    random = 1.0 - (1.0 - LEAST_RANDOM) * fallen
    state, cycles, measured = _collect(task, settings, state, random, collect_key)
    first = (state.rounds * CYCLES) % REPLAY_CYCLES
    replay = jax.tree.map(
        lambda ring, new: jax.lax.dynamic_update_slice_in_dim(ring, new, first, 0),
        state.replay,
        cycles,
    )
    columns = cycles.observation.reshape(-1, cycles.observation.shape[-1]).T
    normaliser = update_normaliser(state.normaliser, columns)
    state = state._replace(replay=replay, normaliser=normaliser, rounds=state.rounds + 1)
    steps = CYCLES * settings.environments * SAMPLES_PER_CYCLE // settings.minibatch
    state, _ = jax.lax.scan(
        partial(_gradient_step, settings), state, jax.random.split(learn_key, steps)
    )
    return state, measured


def _collect(
    task: Task, settings: PPOSettings, state: State, random: Array, key: PRNGKeyArray
) -> tuple[State, Replay, dict[str, Array]]:
    fresh_key, explore_key = jax.random.split(key)
    fresh = reset_many(task, fresh_key, settings.environments)
    fresh_observations = flatten_observation(task.observe(fresh), batch_axes=1)
    actions = len(task.action_names)

    def cycle(state: State, key: PRNGKeyArray) -> tuple[State, tuple[Replay, Array, Any]]:
        keys = jax.random.split(key, 4)
        observation = state.observations
        normalised = normalise(state.normaliser, observation.T)
        count = (settings.environments,)
        new = state.remaining == 0
        best = jnp.argmax(forward(state.networks.action, normalised), axis=1).astype(jnp.int32)
        any_action = jax.random.randint(keys[0], count, 0, actions)
        chosen = jnp.where(jax.random.uniform(keys[1], count) < random, any_action, best)
        action = jnp.where(new, chosen, state.action)
        longest = jnp.argmax(_lengths(state.networks, normalised, action), axis=1)
        any_length = jax.random.randint(keys[2], count, 0, MOST)
        length = jnp.where(
            jax.random.uniform(keys[3], count) < random, any_length, longest.astype(jnp.int32)
        )
        remaining = jnp.where(new, length, state.remaining - 1)
        scenarios, outcome = task.step(state.scenarios, action)
        following = flatten_observation(task.observe(scenarios), batch_axes=1)
        ended = outcome.ended
        flown = Replay(
            observation.T,
            action,
            outcome.reward[0] * settings.reward_scale,
            ended,
            jnp.where(ended, 0, remaining),
            following.T,
        )
        state = state._replace(
            scenarios=choose(ended, fresh, scenarios),
            observations=choose(ended, fresh_observations, following),
            action=action,
            remaining=flown.remaining,
        )
        return state, (flown, ended, outcome.metrics)

    state, (cycles, ended, metrics) = jax.lax.scan(
        cycle, state, jax.random.split(explore_key, CYCLES)
    )
    count = jnp.sum(ended.astype(jnp.float32))
    means = {
        name: jnp.sum(jnp.where(ended, values.astype(jnp.float32), 0.0)) / count
        for name, values in metrics.items()
    }
    return state, cycles, {"episodes": count, **means}


class Runs(NamedTuple):
    """Runs of consecutive cycles within one repetition, with random start and length."""

    observation: Float[Array, "n observation"]
    action: Int[Array, " n"]
    reward: Float[Array, " n"]
    """The sum of rewards, discounted to the first cycle."""
    cycles: Int[Array, " n"]
    discount: Float[Array, " n"]
    """The discount factor for everything after the run; 0 if the scenario ended."""
    following: Float[Array, "n observation"]


def sample_runs(
    replay: Replay, filled: Int[Array, ""], gamma: float, samples: int, key: PRNGKeyArray
) -> Runs:
    """Random runs of random lengths from the first `filled` cycles of the ring.

    A run stays within one round of collection, so it never joins the newest cycle to the oldest one
    in the ring.
    """
    cycle_key, environment_key, length_key = jax.random.split(key, 3)
    first = jax.random.randint(cycle_key, (samples,), 0, filled)
    environment = jax.random.randint(environment_key, (samples,), 0, replay.action.shape[1])
    steps = jnp.arange(MOST)[:, None]
    each = jnp.minimum(first[None] + steps, REPLAY_CYCLES - 1)
    # The end of a scenario cuts a repetition short.
    end = jnp.argmax(replay.remaining[each, environment[None]] == 0, axis=0)
    left = jnp.minimum(end, CYCLES - 1 - first % CYCLES)
    cycles = 1 + jnp.floor(
        jax.random.uniform(length_key, (samples,)) * (left + 1).astype(jnp.float32)
    ).astype(jnp.int32)
    inside = steps < cycles[None]
    rewards = replay.reward[each, environment[None]]
    powers = gamma ** steps.astype(jnp.float32)
    last = first + cycles - 1
    ended = replay.ended[last, environment]
    return Runs(
        replay.observation[first, environment],
        replay.action[first, environment],
        jnp.sum(jnp.where(inside, powers * rewards, 0.0), axis=0),
        cycles,
        jnp.where(ended, 0.0, gamma ** cycles.astype(jnp.float32)),
        replay.following[last, environment],
    )


def _gradient_step(settings: PPOSettings, state: State, key: PRNGKeyArray) -> tuple[State, None]:
    filled = jnp.minimum(state.rounds * CYCLES, REPLAY_CYCLES)
    runs = sample_runs(state.replay, filled, settings.gamma, settings.minibatch, key)
    # The first network learns from single cycles, the second from runs.
    single_key = jax.random.fold_in(key, 0)
    ones = state.replay._replace(remaining=jnp.zeros_like(state.replay.remaining))
    singles = sample_runs(ones, filled, settings.gamma, settings.minibatch, single_key)

    def loss(networks: Networks) -> Float[Array, ""]:
        scaled = partial(normalise, state.normaliser)
        values = forward(networks.action, scaled(singles.observation))
        error = _chosen(values, singles.action) - _target(networks, state, singles)
        lengths = _lengths(networks, scaled(runs.observation), runs.action)
        length_error = _chosen(lengths, runs.cycles - 1) - _target(networks, state, runs)
        return jnp.mean(optax.huber_loss(error)) + jnp.mean(optax.huber_loss(length_error))

    gradient = jax.grad(loss)(state.networks)
    with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
        change, optimiser = _optimiser(settings).update(gradient, state.optimiser)
    networks = optax.apply_updates(state.networks, change)
    targets = jax.tree.map(
        lambda old, new: old + TARGET_RATE * (new - old), state.targets, networks
    )
    return state._replace(networks=networks, targets=targets, optimiser=optimiser), None


def _target(networks: Networks, state: State, runs: Runs) -> Float[Array, " n"]:
    """Double DQN: the online network chooses the next action, the target network evaluates it."""
    following = normalise(state.normaliser, runs.following)
    best = jnp.argmax(forward(networks.action, following), axis=1)
    value = _chosen(forward(state.targets.action, following), best)
    return jax.lax.stop_gradient(runs.reward + runs.discount * value)


def _chosen(values: Float[Array, "n choices"], choice: Int[Array, " n"]) -> Float[Array, " n"]:
    return jnp.take_along_axis(values, choice[:, None], axis=1)[:, 0]
