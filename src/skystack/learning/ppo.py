"""Proximal Policy Optimisation (Schulman et al. 2017).

`update` is the whole algorithm: it collects `steps` steps of each environment
(`skystack.learning.collection`), computes advantages, and makes `epochs` passes of minibatch
gradient steps. `skystack.learning.parts` compiles it. The loop around it is in Python.

A column is one agent of one environment: all agents share the networks. Tasks with several agents
report which are active; samples of inactive agents are ignored.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.compilation.chunks import wanted_first
from skystack.learning import network
from skystack.learning.advantages import Transitions, compute_gae
from skystack.learning.collection import (
    Collected,
    Episodes,
    TrainState,
    collect,
    draw,
    keys_of,
    log_probabilities_of,
    observe_columns,
    of_wanted,
    select,
)
from skystack.learning.inference import forward, normalise
from skystack.learning.network import Head, Parameters
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import reset_many
from skystack.tasks.contract import Task

VALUES_CHUNK = 1024
"""If a task has several agents, the critic evaluates this many observations at once."""


class Samples(NamedTuple):
    """What an update learns from, and the train state after the collection."""

    train_state: TrainState
    raw_observation: Float[Array, "observation samples"]
    batch: Float[Array, "rows samples"]
    """Normalised observations, and what else the loss needs of each sample."""
    active: Bool[Array, " samples"] | None
    """Whether the agent took a decision; None means always."""
    episodes: Episodes


def optimiser(settings: PPOSettings, agents: int = 1) -> optax.GradientTransformation:
    """Adam with gradient clipping and a linear learning-rate schedule."""
    minibatches = max(settings.samples * agents // settings.minibatch, 1)
    schedule = optax.linear_schedule(
        settings.learning_rate,
        settings.learning_rate * settings.final_learning_rate,
        settings.updates * settings.epochs * minibatches,
    )
    return optax.chain(
        optax.clip_by_global_norm(settings.max_gradient_norm),
        optax.adam(schedule, b2=settings.adam_beta2, eps=settings.adam_epsilon),
    )


def init(
    task: Task, settings: PPOSettings, key: PRNGKeyArray, head: Head | None = None
) -> TrainState:
    """A train state with random weights and new scenarios."""
    network_key, scenario_key, key = jax.random.split(key, 3)
    size = len(task.observation_names)
    outputs = len(task.action_names) if head is None else head.outputs
    parameters = network.init(network_key, size, settings.hidden, outputs)
    scenarios = reset_many(task, scenario_key, settings.environments)
    return TrainState(
        parameters=parameters,
        optimiser=optimiser(settings, task.agents).init(ravel_pytree(parameters)[0]),
        normaliser=network.initial_normaliser(size)
        if settings.normalise_observations
        else network.no_normaliser(size),
        scenarios=scenarios,
        observations=observe_columns(task, scenarios),
        returns=jnp.zeros(settings.environments),
        key=key,
        updates=jnp.zeros((), dtype=jnp.int32),
    )


def update(
    task: Task, settings: PPOSettings, train_state: TrainState, head: Head | None = None
) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
    """One update: collect, compute advantages, learn. A pure function, to be compiled.

    Without a `head`, the policy network has one output per action. Returns the train state, and the
    update's metrics by name.
    """
    draws = draw(task, settings, train_state)
    collected = collect(task, settings, train_state, draws, head)
    return improve(task, settings, samples_of(settings, collected), head)


def samples_of(settings: PPOSettings, collected: Collected) -> Samples:
    """The samples of a collection, with values and advantages."""
    train_state, transitions, episodes = collected
    raw_observation = _columns(transitions.observation)
    observation = normalise(train_state.normaliser, raw_observation, columns=True)
    values, next_values = compute_values(train_state, transitions)
    advantages = compute_gae(transitions, values, next_values, settings)
    batch = _pack(observation, transitions, values, advantages)
    active = None if transitions.active is None else transitions.active.reshape(-1)
    return Samples(train_state, raw_observation, batch, active, episodes)


def improve(
    task: Task, settings: PPOSettings, samples: Samples, head: Head | None = None
) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
    """The second half of an update: take gradient steps, then update the normaliser."""
    train_state, raw_observation, batch, active, episodes = samples
    keys = keys_of(train_state)
    train_state, losses = learn(
        settings, train_state, batch, keys.learn, head, active=active, agents=task.agents
    )
    normaliser = train_state.normaliser
    if settings.normalise_observations:
        normaliser = network.update_normaliser(normaliser, raw_observation, active)
    train_state = train_state._replace(
        normaliser=normaliser, key=keys.later, updates=train_state.updates + 1
    )
    return train_state, {**_report(episodes), **losses}


def compute_values(
    train_state: TrainState, transitions: Transitions
) -> tuple[Float[Array, "steps columns"], Float[Array, "steps columns"]]:
    """The critic's values before and after each step; zero before steps of absent agents.

    The value after a step is the value before the next step, unless the scenario ended. At the end
    of a scenario the value matters only after a truncation. Most tasks never truncate, so the
    critic evaluates the final observations only if there was a truncation.
    """
    shape = transitions.reward.shape

    def value(raw: Float[Array, "observation n"]) -> Float[Array, "1 n"]:
        columns = normalise(train_state.normaliser, raw, columns=True)
        return forward(train_state.parameters.critic, columns, columns=True)

    def values_of(
        steps: Float[Array, "steps observation columns"], wanted: Bool[Array, " samples"] | None
    ) -> Float[Array, "steps columns"]:
        return of_wanted(value, 1, _columns(steps), wanted, VALUES_CHUNK).reshape(shape)

    present = truncated = None
    if transitions.active is not None and transitions.waiting is not None:
        present = (transitions.active | transitions.waiting).reshape(-1)
        truncated = transitions.truncated.reshape(-1)
    values = values_of(transitions.observation, present)
    following = jnp.concatenate([values[1:], value(train_state.observations)])

    def with_final_observations() -> Float[Array, "steps columns"]:
        final = values_of(transitions.final_observation, truncated)
        return jnp.where(transitions.truncated, final, following)

    next_values = jax.lax.cond(
        jnp.any(transitions.truncated), with_final_observations, lambda: following
    )
    return values, next_values


def learn(
    settings: PPOSettings,
    train_state: TrainState,
    batch: Float[Array, "rows samples"],
    key: PRNGKeyArray,
    head: Head | None = None,
    active: Bool[Array, " samples"] | None = None,
    agents: int = 1,
) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
    """Make `epochs` passes over shuffled minibatches. An incomplete last minibatch is dropped.

    With `active`, samples of inactive agents come last, and minibatches with any are skipped.
    """
    size = min(settings.minibatch, batch.shape[1])
    count = batch.shape[1] // size
    adam = optimiser(settings, agents)
    vector, as_parameters = ravel_pytree(train_state.parameters)

    def loss_of(
        vector: Float[Array, " weights"], minibatch: Float[Array, "rows minibatch"]
    ) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
        return loss(as_parameters(vector), minibatch, settings, head)

    def gradient_step(
        carry: tuple[Float[Array, " weights"], optax.OptState],
        minibatch: Float[Array, "rows minibatch"],
    ) -> tuple[tuple[Float[Array, " weights"], optax.OptState], dict[str, Array]]:
        vector, state = carry
        gradient, losses = jax.grad(loss_of, has_aux=True)(vector, minibatch)
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
            change, state = adam.update(gradient, state, vector)
        return (vector + change, state), losses

    def skipped(
        carry: tuple[Float[Array, " weights"], optax.OptState],
    ) -> tuple[tuple[Float[Array, " weights"], optax.OptState], dict[str, Array]]:
        """No gradient step; the schedule of the learning rate goes on."""
        vector, state = carry
        counted = jax.tree.map(
            lambda leaf: leaf + 1 if jnp.issubdtype(leaf.dtype, jnp.integer) else leaf, state
        )
        return (vector, counted), dict.fromkeys(LOSSES, jnp.float32(0.0))

    def step_if_active(
        carry: tuple[Float[Array, " weights"], optax.OptState], order: Int[Array, " minibatch"]
    ) -> tuple[tuple[Float[Array, " weights"], optax.OptState], dict[str, Array]]:
        # A minibatch with samples of both kinds is skipped, too.
        assert active is not None
        return jax.lax.cond(
            active[order[-1]], lambda: gradient_step(carry, batch[:, order]), lambda: skipped(carry)
        )

    def epoch(
        carry: tuple[Float[Array, " weights"], optax.OptState], key: PRNGKeyArray
    ) -> tuple[tuple[Float[Array, " weights"], optax.OptState], dict[str, Array]]:
        if active is None:
            order = shuffled(key, batch.shape[1])[: count * size]
            minibatches = batch[:, order].reshape(-1, count, size).swapaxes(0, 1)
            return jax.lax.scan(gradient_step, carry, minibatches)
        order = wanted_first(shuffled(key, batch.shape[1]), active)[: count * size]
        return jax.lax.scan(step_if_active, carry, order.reshape(count, size))

    (vector, state), losses = jax.lax.scan(
        epoch, (vector, train_state.optimiser), jax.random.split(key, settings.epochs)
    )
    train_state = train_state._replace(parameters=as_parameters(vector), optimiser=state)
    if active is None:
        return train_state, jax.tree.map(jnp.mean, losses)
    # Means over the gradient steps: the active samples fill this many minibatches in each epoch.
    steps = settings.epochs * jnp.maximum(jnp.sum(active.astype(jnp.float32)) // size, 1.0)
    return train_state, jax.tree.map(lambda each: jnp.sum(each) / steps, losses)


def shuffled(key: PRNGKeyArray, count: int) -> Int[Array, " count"]:
    """The numbers from 0 to `count` - 1 in random order.

    The numbers are the low bits of random integers, which are sorted. This takes one plain sort and
    is ten times faster than `jax.random.permutation`, which sorts pairs. Numbers with equal random
    high bits (19 bits for 8,192 samples) keep their order.
    """
    low = jnp.uint32((1 << max(count - 1, 1).bit_length()) - 1)
    number = jnp.arange(count, dtype=jnp.uint32)
    uniforms = jax.random.bits(key, (count,), dtype=jnp.uint32)
    return (jnp.sort((uniforms & ~low) | number) & low).astype(jnp.int32)


_EXTRA_ROWS = 4
LOSSES = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction")
"""The measured values of a gradient step."""


def _columns(
    observations: Float[Array, "steps observation columns"],
) -> Float[Array, "observation samples"]:
    """The observations with one column per sample."""
    return jnp.moveaxis(observations, 1, 0).reshape(observations.shape[1], -1)


def _pack(
    observation: Float[Array, "observation samples"],
    transitions: Transitions,
    values: Float[Array, "steps columns"],
    advantages: Float[Array, "steps columns"],
) -> Float[Array, "rows samples"]:
    """One column per sample, so that shuffling is one gather: the observation, then extra rows."""
    extra = (
        transitions.action.astype(jnp.float32),
        transitions.log_probability,
        advantages,
        advantages + values,
    )
    return jnp.concatenate([observation, *(values.reshape(1, -1) for values in extra)])


def loss(
    parameters: Parameters,
    minibatch: Float[Array, "rows minibatch"],
    settings: PPOSettings,
    head: Head | None = None,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """The PPO loss of one minibatch: clipped surrogate, value error and entropy.

    Samples are columns, contiguous in memory, which makes a gradient step up to a third faster.
    """
    observation = minibatch[:-_EXTRA_ROWS]
    action, old_log_probability, advantage, value_target = minibatch[-_EXTRA_ROWS:]
    log_probabilities = log_probabilities_of(parameters, observation, head)
    entropy = -jnp.mean(jnp.sum(jnp.exp(log_probabilities) * log_probabilities, axis=0))
    change = select(log_probabilities, action.astype(jnp.int32)) - old_log_probability
    ratio = jnp.exp(change)
    if settings.normalise_advantages:
        advantage = (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
    clipped = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    policy_loss = -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))
    value = forward(parameters.critic, observation, columns=True)[0]
    value_loss = 0.5 * jnp.mean((value - value_target) ** 2)
    total = policy_loss + settings.value_coefficient * value_loss - settings.entropy * entropy
    kl = jnp.mean(ratio - 1.0 - change)
    clip_fraction = jnp.mean((jnp.abs(ratio - 1.0) > settings.clip).astype(jnp.float32))
    measured = (policy_loss, value_loss, entropy, kl, clip_fraction)
    return total, dict(zip(LOSSES, measured, strict=True))


def _report(episodes: Episodes) -> dict[str, Float[Array, ""]]:
    """Means over the scenarios that ended; NaN if none ended."""
    ended, episode_return, metrics = jax.tree.map(jnp.sum, episodes)
    sums = {"return": episode_return, **metrics}
    return {"episodes": ended} | {name: value / ended for name, value in sums.items()}
