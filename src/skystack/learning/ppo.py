"""Proximal Policy Optimisation (Schulman et al. 2017): the whole algorithm, top to bottom.

`update` is one compiled program: it collects `steps` steps of every environment, computes
advantages, and takes `epochs` passes of minibatch gradient steps. The loop round it is Python.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.learning import network
from skystack.learning.inference import Normaliser
from skystack.learning.network import Parameters
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import choose, reset_many
from skystack.tasks.contract import Metrics, Outcome, Task, TaskState


class TrainState(NamedTuple):
    """Everything that changes during training."""

    parameters: Parameters
    optimiser: optax.OptState
    """Of all parameters in one vector: one step of Adam on it costs less than on a dozen arrays."""
    normaliser: Normaliser
    scenarios: TaskState
    """One state an environment, axis last."""
    observations: Float[Array, "observation environments"]
    returns: Float[Array, " environments"]
    """Undiscounted, unscaled, of the scenarios under way."""
    key: PRNGKeyArray
    updates: Int[Array, ""]


class Transitions(NamedTuple):
    """What an update collects."""

    observation: Float[Array, "steps observation environments"]
    final_observation: Float[Array, "steps observation environments"]
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


def init(task: Task, settings: PPOSettings, key: PRNGKeyArray) -> TrainState:
    """A learner with random weights in fresh scenarios."""
    network_key, scenario_key, key = jax.random.split(key, 3)
    size = len(task.observation_names)
    parameters = network.init(network_key, size, settings.hidden, len(task.action_names))
    scenarios = reset_many(task, scenario_key, settings.environments)
    return TrainState(
        parameters=parameters,
        optimiser=optimiser(settings).init(ravel_pytree(parameters)[0]),
        normaliser=network.initial_normaliser(size),
        scenarios=scenarios,
        observations=task.observe(scenarios),
        returns=jnp.zeros(settings.environments),
        key=key,
        updates=jnp.zeros((), dtype=jnp.int32),
    )


def update(
    task: Task, settings: PPOSettings, learner: TrainState
) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
    """One update: collect, judge, learn. Returns what was measured of it; pure, to be compiled."""
    key, collect_key, learn_key = jax.random.split(learner.key, 3)
    learner = learner._replace(key=key)
    learner, steps, episodes = collect(task, settings, learner, collect_key)
    seen = _columns(steps.observation)
    observation = network.normalise_columns(learner.normaliser, seen)
    values, next_values = compute_values(learner, steps, observation)
    advantages = compute_gae(steps, values, next_values, settings)
    batch = _pack(observation, steps, values, advantages)
    learner, losses = learn(settings, learner, batch, learn_key)
    learner = learner._replace(
        normaliser=network.update_normaliser(learner.normaliser, seen), updates=learner.updates + 1
    )
    return learner, {**_report(episodes), **losses}


def collect(
    task: Task, settings: PPOSettings, learner: TrainState, key: PRNGKeyArray
) -> tuple[TrainState, Transitions, Episodes]:
    """`steps` steps of every environment with the present policy.

    Every environment has one fresh scenario at hand for when its own ends; should that one end
    within the same collection too, it is started once more.
    """
    fresh_key, action_key = jax.random.split(key)
    # All at once: random numbers drawn step by step cost more than the policy.
    uniforms = jax.random.uniform(action_key, (settings.steps, settings.environments))
    fresh = reset_many(task, fresh_key, settings.environments)
    fresh_observations = task.observe(fresh)

    def step(
        learner: TrainState, uniforms: Float[Array, " environments"]
    ) -> tuple[TrainState, tuple[Transitions, Episodes]]:
        observation = learner.observations
        seen = network.normalise_columns(learner.normaliser, observation)
        log_probabilities = jax.nn.log_softmax(
            network.forward_columns(learner.parameters.actor, seen), axis=0
        )
        action = sample_actions(log_probabilities, uniforms)
        scenarios, outcome = task.step(learner.scenarios, action)
        final_observation = task.observe(scenarios)
        ended = outcome.terminated | outcome.truncated
        returns = learner.returns + outcome.reward
        taken = Transitions(
            observation=observation,
            final_observation=final_observation,
            action=action,
            log_probability=_select(log_probabilities, action),
            reward=outcome.reward * settings.reward_scale,
            terminated=outcome.terminated,
            truncated=outcome.truncated,
        )
        learner = learner._replace(
            scenarios=choose(ended, fresh, scenarios),
            observations=choose(ended, fresh_observations, final_observation),
            returns=jnp.where(ended, 0.0, returns),
        )
        return learner, (taken, _sum_ended(ended, returns, outcome))

    learner, (steps, episodes) = jax.lax.scan(step, learner, uniforms)
    return learner, steps, jax.tree.map(jnp.sum, episodes)


def sample_actions(
    log_probabilities: Float[Array, "actions n"], uniforms: Float[Array, " n"]
) -> Int[Array, " n"]:
    """An action each by its probability, from a number uniform on [0, 1): the inverse of the
    distribution function."""
    actions = log_probabilities.shape[0]
    up_to = jnp.tril(jnp.ones((actions, actions))) @ jnp.exp(log_probabilities)
    beyond = uniforms[None, :] >= up_to[:-1]
    return jnp.sum(beyond.astype(jnp.int32), axis=0)


def compute_values(
    learner: TrainState, steps: Transitions, observation: Float[Array, "observation samples"]
) -> tuple[Float[Array, "steps environments"], Float[Array, "steps environments"]]:
    """The critic's values of what was seen before each step (given normalised) and after it.

    After a step is before the next one, but where a scenario ended. There the value counts only if
    it was cut short, and most tasks never do that: only then is the critic asked of all those too.
    """

    def value(columns: Float[Array, "observation n"]) -> Float[Array, " n"]:
        return network.forward_columns(learner.parameters.critic, columns)[0]

    values = value(observation).reshape(steps.reward.shape)
    last = value(network.normalise_columns(learner.normaliser, learner.observations))

    def after_every_step() -> Float[Array, "steps environments"]:
        final = network.normalise_columns(learner.normaliser, _columns(steps.final_observation))
        return value(final).reshape(steps.reward.shape)

    following = jnp.concatenate([values[1:], last[None]])
    next_values = jax.lax.cond(jnp.any(steps.truncated), after_every_step, lambda: following)
    return values, next_values


def compute_gae(
    steps: Transitions,
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
    learner: TrainState,
    batch: Float[Array, "rows samples"],
    key: PRNGKeyArray,
) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
    """`epochs` passes over shuffled minibatches; what does not fill one is left out."""
    size = min(settings.minibatch, batch.shape[1])
    count = batch.shape[1] // size
    adam = optimiser(settings)
    vector, as_parameters = ravel_pytree(learner.parameters)

    def loss_of(
        vector: Float[Array, " weights"], minibatch: Float[Array, "rows minibatch"]
    ) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
        return loss(as_parameters(vector), minibatch, settings)

    def gradient_step(
        carry: tuple[Float[Array, " weights"], optax.OptState],
        minibatch: Float[Array, "rows minibatch"],
    ) -> tuple[tuple[Float[Array, " weights"], optax.OptState], dict[str, Array]]:
        vector, state = carry
        gradient, losses = jax.grad(loss_of, has_aux=True)(vector, minibatch)
        with jax.numpy_dtype_promotion("standard"):  # optax counts steps in integers
            change, state = adam.update(gradient, state, vector)
        return (vector + change, state), losses

    def epoch(
        carry: tuple[Float[Array, " weights"], optax.OptState], key: PRNGKeyArray
    ) -> tuple[tuple[Float[Array, " weights"], optax.OptState], dict[str, Array]]:
        order = shuffled(key, batch.shape[1])[: count * size]
        minibatches = batch[:, order].reshape(-1, count, size).swapaxes(0, 1)
        return jax.lax.scan(gradient_step, carry, minibatches)

    (vector, state), losses = jax.lax.scan(
        epoch, (vector, learner.optimiser), jax.random.split(key, settings.epochs)
    )
    learner = learner._replace(parameters=as_parameters(vector), optimiser=state)
    return learner, jax.tree.map(jnp.mean, losses)


def shuffled(key: PRNGKeyArray, count: int) -> Int[Array, " count"]:
    """The numbers below `count` in random order.

    They ride in the low bits of the random numbers that are sorted: one plain sort, ten times
    faster than `jax.random.permutation`, which sorts pairs. Where the random bits above them are
    equal (19 of them for 8,192 samples) the order stays.
    """
    low = jnp.uint32((1 << max(count - 1, 1).bit_length()) - 1)
    number = jnp.arange(count, dtype=jnp.uint32)
    uniforms = jax.random.bits(key, (count,), dtype=jnp.uint32)
    return (jnp.sort((uniforms & ~low) | number) & low).astype(jnp.int32)


_EXTRA_ROWS = 4


def _columns(
    observations: Float[Array, "steps observation environments"],
) -> Float[Array, "observation samples"]:
    """A column a sample."""
    return jnp.moveaxis(observations, 1, 0).reshape(observations.shape[1], -1)


def _pack(
    observation: Float[Array, "observation samples"],
    steps: Transitions,
    values: Float[Array, "steps environments"],
    advantages: Float[Array, "steps environments"],
) -> Float[Array, "rows samples"]:
    """A column a sample, so that shuffling is one gather: observation, then the extra rows."""
    extra = (
        steps.action.astype(jnp.float32),
        steps.log_probability,
        advantages,
        advantages + values,
    )
    return jnp.concatenate([observation, *(values.reshape(1, -1) for values in extra)])


def loss(
    parameters: Parameters, minibatch: Float[Array, "rows minibatch"], settings: PPOSettings
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Clipped surrogate, value error and entropy of one minibatch.

    A sample is a column here: sums over actions and products with it then run along contiguous
    memory, which makes a gradient step up to a third faster.
    """
    observation = minibatch[:-_EXTRA_ROWS]
    action, old_log_probability, advantage, value_target = minibatch[-_EXTRA_ROWS:]
    log_probabilities = jax.nn.log_softmax(
        network.forward_columns(parameters.actor, observation), axis=0
    )
    entropy = -jnp.mean(jnp.sum(jnp.exp(log_probabilities) * log_probabilities, axis=0))
    change = _select(log_probabilities, action.astype(jnp.int32)) - old_log_probability
    ratio = jnp.exp(change)
    advantage = (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
    clipped = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    policy_loss = -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))
    value = network.forward_columns(parameters.critic, observation)[0]
    value_loss = 0.5 * jnp.mean((value - value_target) ** 2)
    total = policy_loss + settings.value_coefficient * value_loss - settings.entropy * entropy
    return total, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": jnp.mean(ratio - 1.0 - change),
        "clip_fraction": jnp.mean((jnp.abs(ratio - 1.0) > settings.clip).astype(jnp.float32)),
    }


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
    """Means over the ended scenarios; NaN where none ended."""
    sums = {"return": episodes.episode_return, **episodes.metrics._asdict()}
    return {"episodes": episodes.ended} | {
        name: value / episodes.ended for name, value in sums.items()
    }
