"""Proximal Policy Optimisation (Schulman et al. 2017): the whole algorithm, top to bottom.

`update` is one compiled program: it collects `steps` steps of every environment, computes
advantages, and takes `epochs` passes of minibatch gradient steps. The loop round it is Python.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.learning import network
from skystack.learning.inference import Layers, Normaliser, forward, normalise
from skystack.learning.network import Parameters
from skystack.learning.settings import PPOSettings
from skystack.tasks.contract import Metrics, Outcome, Task, TaskState


class Learner(NamedTuple):
    """Everything that changes during training."""

    parameters: Parameters
    optimiser: optax.OptState
    normaliser: Normaliser
    scenarios: TaskState
    """One state an environment."""
    observations: Float[Array, "environments observation"]
    returns: Float[Array, " environments"]
    """Undiscounted, unscaled, of the scenarios under way."""
    key: PRNGKeyArray
    updates: Int[Array, ""]


class Steps(NamedTuple):
    """What an update collects: `[steps, environments]`."""

    observation: Float[Array, "steps environments observation"]
    final_observation: Float[Array, "steps environments observation"]
    """After the step, before a new scenario takes the place of an ended one."""
    action: Int[Array, "steps environments"]
    log_probability: Float[Array, "steps environments"]
    reward: Float[Array, "steps environments"]
    """Scaled."""
    terminated: Bool[Array, "steps environments"]
    truncated: Bool[Array, "steps environments"]


class Episodes(NamedTuple):
    """Sums over the scenarios that ended; all divided by `ended` when reported."""

    ended: Float[Array, ""]
    episode_return: Float[Array, ""]
    metrics: Metrics


def optimiser(settings: PPOSettings) -> optax.GradientTransformation:
    """Adam with clipped gradients and a linear learning-rate schedule."""
    minibatches = max(settings.samples // settings.minibatch, 1)
    schedule = optax.linear_schedule(
        settings.learning_rate,
        settings.learning_rate * settings.final_learning_rate,
        settings.updates * settings.epochs * minibatches,
    )
    return optax.chain(
        optax.clip_by_global_norm(settings.max_gradient_norm),
        optax.adam(schedule, b2=settings.adam_beta2, eps=settings.adam_epsilon),
    )


def init(task: Task, settings: PPOSettings, key: PRNGKeyArray) -> Learner:
    """A learner with random weights in fresh scenarios."""
    network_key, scenario_key, key = jax.random.split(key, 3)
    size = len(task.observation_names)
    parameters = network.init(network_key, size, settings.hidden, len(task.action_names))
    scenarios = jax.vmap(task.reset)(jax.random.split(scenario_key, settings.environments))
    return Learner(
        parameters=parameters,
        optimiser=optimiser(settings).init(parameters),
        normaliser=network.initial_normaliser(size),
        scenarios=scenarios,
        observations=jax.vmap(task.observe)(scenarios),
        returns=jnp.zeros(settings.environments),
        key=key,
        updates=jnp.zeros((), dtype=jnp.int32),
    )


def update(
    task: Task, settings: PPOSettings, learner: Learner
) -> tuple[Learner, dict[str, Float[Array, ""]]]:
    """One update: collect, judge, learn. Returns what was measured of it; pure, to be compiled."""
    key, collect_key, learn_key = jax.random.split(learner.key, 3)
    learner = learner._replace(key=key)
    learner, steps, episodes = collect(task, settings, learner, collect_key)
    critic, normaliser = learner.parameters.critic, learner.normaliser
    values = _value(critic, normaliser, steps.observation)
    next_values = _value(critic, normaliser, steps.final_observation)
    advantages = generalised_advantages(steps, values, next_values, settings)
    batch = _pack(normaliser, steps, values, advantages)
    learner, losses = learn(settings, learner, batch, learn_key)
    size = steps.observation.shape[-1]
    learner = learner._replace(
        normaliser=network.update_normaliser(normaliser, steps.observation.reshape(-1, size)),
        updates=learner.updates + 1,
    )
    return learner, {**_report(episodes), **losses}


def collect(
    task: Task, settings: PPOSettings, learner: Learner, key: PRNGKeyArray
) -> tuple[Learner, Steps, Episodes]:
    """`steps` steps of every environment with the present policy.

    Every environment has one fresh scenario at hand for when its own ends; should that one end
    within the same collection too, it is started once more.
    """
    fresh_key, action_key = jax.random.split(key)
    fresh = jax.vmap(task.reset)(jax.random.split(fresh_key, settings.environments))
    fresh_observations = jax.vmap(task.observe)(fresh)

    def step(learner: Learner, key: PRNGKeyArray) -> tuple[Learner, tuple[Steps, Episodes]]:
        observation = learner.observations
        logits = forward(learner.parameters.actor, normalise(learner.normaliser, observation))
        action = jax.random.categorical(key, logits).astype(jnp.int32)
        scenarios, outcome = jax.vmap(task.step)(learner.scenarios, action)
        final_observation = jax.vmap(task.observe)(scenarios)
        ended = outcome.terminated | outcome.truncated
        returns = learner.returns + outcome.reward
        taken = Steps(
            observation=observation,
            final_observation=final_observation,
            action=action,
            log_probability=_log_probability(logits, action),
            reward=outcome.reward * settings.reward_scale,
            terminated=outcome.terminated,
            truncated=outcome.truncated,
        )
        learner = learner._replace(
            scenarios=_choose(ended, fresh, scenarios),
            observations=_choose(ended, fresh_observations, final_observation),
            returns=jnp.where(ended, 0.0, returns),
        )
        return learner, (taken, _sum_ended(ended, returns, outcome))

    keys = jax.random.split(action_key, settings.steps)
    learner, (steps, episodes) = jax.lax.scan(step, learner, keys)
    return learner, steps, jax.tree.map(jnp.sum, episodes)


def generalised_advantages(
    steps: Steps,
    values: Float[Array, "steps environments"],
    next_values: Float[Array, "steps environments"],
    settings: PPOSettings,
) -> Float[Array, "steps environments"]:
    """Generalised advantage estimation (Schulman et al. 2016).

    Nothing is expected beyond a termination; beyond a truncation, the value of the final
    observation. Neither lets a later scenario leak into an earlier one.
    """
    target = steps.reward + settings.gamma * jnp.where(steps.terminated, 0.0, next_values)
    ended = steps.terminated | steps.truncated
    carried = settings.gamma * settings.gae_lambda * (1.0 - ended.astype(jnp.float32))

    def back(
        later: Float[Array, " environments"], now: tuple[Array, Array]
    ) -> tuple[Float[Array, " environments"], Float[Array, " environments"]]:
        error, carry = now
        advantage = error + carry * later
        return advantage, advantage

    start = jnp.zeros(values.shape[1])
    _, advantages = jax.lax.scan(back, start, (target - values, carried), reverse=True)
    return advantages


def learn(
    settings: PPOSettings,
    learner: Learner,
    batch: Float[Array, "samples columns"],
    key: PRNGKeyArray,
) -> tuple[Learner, dict[str, Float[Array, ""]]]:
    """`epochs` passes over shuffled minibatches; what does not fill one is left out."""
    size = min(settings.minibatch, batch.shape[0])
    count = batch.shape[0] // size
    adam = optimiser(settings)

    def gradient_step(
        carry: tuple[Parameters, optax.OptState], rows: Float[Array, "minibatch columns"]
    ) -> tuple[tuple[Parameters, optax.OptState], dict[str, Array]]:
        parameters, state = carry
        gradients, losses = jax.grad(loss, has_aux=True)(parameters, rows, settings)
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
            updates, state = adam.update(gradients, state, parameters)
        new: Parameters = optax.apply_updates(parameters, updates)
        return (new, state), losses

    def epoch(
        carry: tuple[Parameters, optax.OptState], key: PRNGKeyArray
    ) -> tuple[tuple[Parameters, optax.OptState], dict[str, Array]]:
        order = jax.random.permutation(key, batch.shape[0])[: count * size]
        minibatches = batch[order].reshape(count, size, batch.shape[1])
        return jax.lax.scan(gradient_step, carry, minibatches)

    (parameters, state), losses = jax.lax.scan(
        epoch,
        (learner.parameters, learner.optimiser),
        jax.random.split(key, settings.epochs),
    )
    return learner._replace(parameters=parameters, optimiser=state), jax.tree.map(jnp.mean, losses)


_EXTRA_COLUMNS = 4


def _pack(
    normaliser: Normaliser,
    steps: Steps,
    values: Float[Array, "steps environments"],
    advantages: Float[Array, "steps environments"],
) -> Float[Array, "samples columns"]:
    """One row a sample, so that shuffling is one gather: observation, then the extra columns."""
    observation = normalise(normaliser, steps.observation)
    columns = (
        steps.action.astype(jnp.float32),
        steps.log_probability,
        advantages,
        advantages + values,
    )
    packed = jnp.concatenate([observation, jnp.stack(columns, axis=-1)], axis=-1)
    return packed.reshape(-1, packed.shape[-1])


def loss(
    parameters: Parameters, rows: Float[Array, "minibatch columns"], settings: PPOSettings
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Clipped surrogate, value error and entropy of one minibatch."""
    observation = rows[:, :-_EXTRA_COLUMNS]
    action, old_log_probability, advantage, value_target = rows[:, -_EXTRA_COLUMNS:].T
    logits = forward(parameters.actor, observation)
    log_probabilities = jax.nn.log_softmax(logits)
    entropy = -jnp.mean(jnp.sum(jnp.exp(log_probabilities) * log_probabilities, axis=1))
    change = _log_probability(logits, action.astype(jnp.int32)) - old_log_probability
    ratio = jnp.exp(change)
    advantage = (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
    clipped = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    policy_loss = -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))
    value = forward(parameters.critic, observation)[:, 0]
    value_loss = 0.5 * jnp.mean((value - value_target) ** 2)
    total = policy_loss + settings.value_coefficient * value_loss - settings.entropy * entropy
    return total, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": jnp.mean(ratio - 1.0 - change),
        "clip_fraction": jnp.mean((jnp.abs(ratio - 1.0) > settings.clip).astype(jnp.float32)),
    }


def _value(
    critic: Layers, normaliser: Normaliser, observation: Float[Array, "*n observation"]
) -> Float[Array, "*n"]:
    output: Array = forward(critic, normalise(normaliser, observation))
    return output[..., 0]


def _log_probability(
    logits: Float[Array, "n actions"], action: Int[Array, " n"]
) -> Float[Array, " n"]:
    chosen = jnp.arange(logits.shape[1])[None, :] == action[:, None]
    return jnp.sum(jnp.where(chosen, jax.nn.log_softmax(logits), 0.0), axis=1)


def _choose(condition: Bool[Array, " environments"], yes: TaskState, no: TaskState) -> TaskState:
    """Per environment, one of two states."""

    def pick(a: Array, b: Array) -> Array:
        return jnp.where(condition.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(pick, yes, no)


def _sum_ended(
    ended: Bool[Array, " environments"], returns: Float[Array, " environments"], outcome: Outcome
) -> Episodes:
    def total(values: Array) -> Array:
        return jnp.sum(jnp.where(ended, values.astype(jnp.float32), 0.0))

    return Episodes(
        jnp.sum(ended.astype(jnp.float32)), total(returns), jax.tree.map(total, outcome.metrics)
    )


def _report(episodes: Episodes) -> dict[str, Float[Array, ""]]:
    """Means over the ended scenarios; NaN where none ended."""
    sums = {"return": episodes.episode_return, **episodes.metrics._asdict()}
    return {"episodes": episodes.ended} | {
        name: value / episodes.ended for name, value in sums.items()
    }
