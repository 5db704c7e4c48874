"""Proximal Policy Optimisation (Schulman et al. 2017): the whole algorithm, top to bottom.

`update` is one compiled program: it collects `steps` steps of each environment, computes
advantages, and makes `epochs` passes of minibatch gradient steps. The loop around it is in Python.

A column is one agent of one environment: all agents share the networks. Tasks with several agents
report which are active; samples of inactive agents are ignored.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

from skystack.compilation.chunks import in_chunks, wanted_first
from skystack.learning import network
from skystack.learning.advantages import Transitions, compute_gae
from skystack.learning.inference import Normaliser, forward, normalise
from skystack.learning.network import Head, Parameters
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import choose, reset_many
from skystack.tasks.contract import ManyAgents, Metrics, Outcome, Task, TaskState
from skystack.tasks.observations import flatten_observation

CHUNK = 1024
"""Observations of active agents are evaluated in chunks of this size."""


class TrainState(NamedTuple):
    """All state that changes during training."""

    parameters: Parameters
    optimiser: optax.OptState
    """The state for all parameters in one vector: Adam is faster on it than on a dozen arrays."""
    normaliser: Normaliser
    scenarios: TaskState
    """The states of all environments, batch axis last."""
    observations: Float[Array, "observation columns"]
    returns: Float[Array, " environments"]
    """The undiscounted, unscaled returns so far of the current scenarios, of all agents."""
    key: PRNGKeyArray
    updates: Int[Array, ""]


class Episodes(NamedTuple):
    """Sums over the scenarios that ended. Divided by `ended` for reporting."""

    ended: Float[Array, ""]
    episode_return: Float[Array, ""]
    metrics: Metrics


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
        observations=_observe(task, scenarios),
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
    key, collect_key, learn_key = jax.random.split(train_state.key, 3)
    train_state = train_state._replace(key=key)
    train_state, transitions, episodes = collect(task, settings, train_state, collect_key, head)
    raw_observation = _columns(transitions.observation)
    observation = normalise(train_state.normaliser, raw_observation, columns=True)
    values, next_values = compute_values(train_state, transitions)
    advantages = compute_gae(transitions, values, next_values, settings)
    batch = _pack(observation, transitions, values, advantages)
    active = None if transitions.active is None else transitions.active.reshape(-1)
    train_state, losses = learn(
        settings, train_state, batch, learn_key, head, active=active, agents=task.agents
    )
    normaliser = train_state.normaliser
    if settings.normalise_observations:
        normaliser = network.update_normaliser(normaliser, raw_observation, active)
    train_state = train_state._replace(normaliser=normaliser, updates=train_state.updates + 1)
    return train_state, {**_report(episodes), **losses}


def collect(
    task: Task,
    settings: PPOSettings,
    train_state: TrainState,
    key: PRNGKeyArray,
    head: Head | None = None,
) -> tuple[TrainState, Transitions, Episodes]:
    """Collect `steps` steps of each environment with the current policy.

    Each environment has one new scenario in reserve, which starts when the current scenario ends.
    If it also ends during the collection, the same scenario starts again.
    """
    fresh_key, action_key = jax.random.split(key)
    # Drawn all at once: drawing random numbers at each step costs more than the policy.
    columns = task.agents * settings.environments
    uniforms = jax.random.uniform(action_key, (settings.steps, columns))
    fresh = reset_many(task, fresh_key, settings.environments)
    fresh_observations = _observe(task, fresh)

    def step(
        train_state: TrainState, uniforms: Float[Array, " columns"]
    ) -> tuple[TrainState, tuple[Transitions, Episodes]]:
        observation = train_state.observations
        active, waiting = _deciding(task, train_state.scenarios)
        log_probabilities = _of_active(
            partial(_policy, train_state, head), len(task.action_names), observation, active
        )
        action = sample_actions(log_probabilities, uniforms)
        scenarios, outcome = task.step(train_state.scenarios, _by_agent(task, action))
        final_observation = _observe(task, scenarios)
        reward, ended = outcome.reward.reshape(-1), outcome.ended
        returns = train_state.returns + jnp.sum(outcome.reward, axis=0)
        transition = Transitions(
            observation=observation,
            final_observation=final_observation,
            action=action,
            log_probability=_select(log_probabilities, action),
            reward=reward * settings.reward_scale,
            terminated=outcome.terminated.reshape(-1),
            truncated=outcome.truncated.reshape(-1),
            time_steps=None if outcome.steps is None else _columns_of(task, outcome.steps),
            active=active,
            waiting=waiting,
        )
        train_state = train_state._replace(
            scenarios=choose(ended, fresh, scenarios),
            observations=choose(_columns_of(task, ended), fresh_observations, final_observation),
            returns=jnp.where(ended, 0.0, returns),
        )
        return train_state, (transition, _sum_ended(ended, returns, outcome))

    train_state, (transitions, episodes) = jax.lax.scan(step, train_state, uniforms)
    return train_state, transitions, jax.tree.map(jnp.sum, episodes)


def sample_actions(
    log_probabilities: Float[Array, "actions n"], uniforms: Float[Array, " n"]
) -> Int[Array, " n"]:
    """Sample one action per column by inverse transform sampling.

    `uniforms` are uniform on [0, 1).
    """
    actions = log_probabilities.shape[0]
    cumulative = jnp.tril(jnp.ones((actions, actions))) @ jnp.exp(log_probabilities)
    beyond = uniforms[None, :] >= cumulative[:-1]
    return jnp.sum(beyond.astype(jnp.int32), axis=0)


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

    present = truncated = None
    if transitions.active is not None and transitions.waiting is not None:
        present = (transitions.active | transitions.waiting).reshape(-1)
        truncated = transitions.truncated.reshape(-1)
    values = _of_active(value, 1, _columns(transitions.observation), present).reshape(shape)
    following = jnp.concatenate([values[1:], value(train_state.observations)])

    def with_final_observations() -> Float[Array, "steps columns"]:
        final = _of_active(value, 1, _columns(transitions.final_observation), truncated)
        return jnp.where(transitions.truncated, final.reshape(shape), following)

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


def _policy(
    train_state: TrainState, head: Head | None, observation: Float[Array, "observation n"]
) -> Float[Array, "actions n"]:
    """The logarithms of the probabilities of the actions."""
    normalised = normalise(train_state.normaliser, observation, columns=True)
    return _log_probabilities(train_state.parameters, normalised, head)


def _of_active(
    function: Callable[[Float[Array, "observation n"]], Float[Array, "outputs n"]],
    outputs: int,
    columns: Float[Array, "observation columns"],
    active: Bool[Array, " columns"] | None,
) -> Float[Array, "outputs columns"]:
    """The function of the active columns, and zero for the others; None: all are active."""
    if active is None:
        return function(columns)
    nothing = jnp.zeros((outputs, columns.shape[1]))
    return in_chunks(active, lambda column: function(columns[:, column]), nothing, CHUNK)


def _observe(task: Task, scenarios: TaskState) -> Float[Array, "observation columns"]:
    """The observations of all agents of all environments, agent by agent."""
    if task.agents == 1:
        return flatten_observation(task.observe(scenarios), batch_axes=1)
    observation = flatten_observation(task.observe(scenarios), batch_axes=2)
    return observation.reshape(observation.shape[0], -1)


def _by_agent(task: Task, action: Int[Array, " columns"]) -> Int[Array, "*agents environments"]:
    """The actions as a task takes them: with an axis of agents if there are several."""
    return action if task.agents == 1 else action.reshape(task.agents, -1)


def _deciding(
    task: Task, scenarios: TaskState
) -> tuple[Bool[Array, " columns"] | None, Bool[Array, " columns"] | None]:
    """Which agents decide, and which others wait; None and None if there is one agent."""
    if not isinstance(task, ManyAgents):
        return None, None
    return task.active(scenarios).reshape(-1), task.waiting(scenarios).reshape(-1)


def _columns_of(task: Task, values: Shaped[Array, " environments"]) -> Shaped[Array, " columns"]:
    """The values of environments, for each of their agents."""
    return jnp.tile(values, task.agents)


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
    log_probabilities = _log_probabilities(parameters, observation, head)
    entropy = -jnp.mean(jnp.sum(jnp.exp(log_probabilities) * log_probabilities, axis=0))
    change = _select(log_probabilities, action.astype(jnp.int32)) - old_log_probability
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


def _log_probabilities(
    parameters: Parameters, observation: Float[Array, "observation n"], head: Head | None
) -> Float[Array, "actions n"]:
    outputs = forward(parameters.actor, observation, columns=True)
    return jax.nn.log_softmax(outputs if head is None else head.logits(outputs), axis=0)


def _select(
    log_probabilities: Float[Array, "actions n"], action: Int[Array, " n"]
) -> Float[Array, " n"]:
    taken = jnp.arange(log_probabilities.shape[0])[:, None] == action[None, :]
    return jnp.sum(jnp.where(taken, log_probabilities, 0.0), axis=0)


def _sum_ended(
    ended: Bool[Array, " environments"], returns: Float[Array, " environments"], outcome: Outcome
) -> Episodes:
    def total(values: Array) -> Array:
        return jnp.sum(jnp.where(ended, values.astype(jnp.float32), 0.0))

    return Episodes(
        jnp.sum(ended.astype(jnp.float32)), total(returns), jax.tree.map(total, outcome.metrics)
    )


def _report(episodes: Episodes) -> dict[str, Float[Array, ""]]:
    """Means over the scenarios that ended; NaN if none ended."""
    sums = {"return": episodes.episode_return, **episodes.metrics}
    return {"episodes": episodes.ended} | {
        name: value / episodes.ended for name, value in sums.items()
    }
