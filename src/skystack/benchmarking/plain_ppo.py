"""PPO written like PureJaxRL, on skystack's task: the trainer without its optimisations.

The same algorithm and sizes as `skystack.learning.ppo`, in the simplest form: scenarios are vmapped
over the first axis, every step has its own key, actions are sampled with Gumbel noise, every step
draws a new scenario for every environment, values are stored in the rollout, and the batch is
shuffled by permuting every array. Only for measuring speed; observations are normalised by
constants.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, PRNGKeyArray

from skystack.learning import network
from skystack.learning.inference import forward
from skystack.learning.settings import PPOSettings
from skystack.tasks.contract import Task


class Carry(NamedTuple):
    parameters: network.Parameters
    optimiser: Any
    states: Any
    observations: Array
    key: PRNGKeyArray


class Transition(NamedTuple):
    observation: Array
    action: Array
    log_probability: Array
    value: Array
    reward: Array
    ended: Array


def start(task: Task, settings: PPOSettings, key: PRNGKeyArray) -> Carry:
    """A learner with new scenarios."""
    network_key, reset_key, key = jax.random.split(key, 3)
    parameters = network.init(
        network_key, len(task.observation_names), settings.hidden, len(task.action_names)
    )
    states = jax.vmap(task.reset)(jax.random.split(reset_key, settings.environments))
    observations = jax.vmap(task.observe)(states)
    return Carry(parameters, adam(settings).init(parameters), states, observations, key)


def adam(settings: PPOSettings) -> optax.GradientTransformation:
    """Adam with clipped gradients."""
    clip = optax.clip_by_global_norm(settings.max_gradient_norm)
    return optax.chain(clip, optax.adam(settings.learning_rate, eps=settings.adam_epsilon))


def update(task: Task, settings: PPOSettings, carry: Carry) -> tuple[Carry, Array]:
    """One update: collect steps, compute advantages, learn."""
    carry, steps = jax.lax.scan(lambda c, _: step(task, settings, c), carry, None, settings.steps)
    last = forward(carry.parameters.critic, _centred(carry.observations))[:, 0]

    def gae(later: tuple[Array, Array], now: Transition) -> tuple[tuple[Array, Array], Array]:
        advantage, next_value = later
        continues = 1.0 - now.ended.astype(jnp.float32)
        error = now.reward + settings.gamma * next_value * continues - now.value
        advantage = error + settings.gamma * settings.gae_lambda * continues * advantage
        return (advantage, now.value), advantage

    _, advantages = jax.lax.scan(gae, (jnp.zeros_like(last), last), steps, reverse=True)
    batch = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), (steps, advantages))

    def epoch(carry: Carry, _: Any) -> tuple[Carry, Array]:
        key, shuffle = jax.random.split(carry.key)
        order = jax.random.permutation(shuffle, settings.samples)
        count = settings.samples // settings.minibatch
        shuffled = jax.tree.map(
            lambda x: x[order][: count * settings.minibatch].reshape(
                count, settings.minibatch, *x.shape[1:]
            ),
            batch,
        )
        return jax.lax.scan(lambda c, b: learn(settings, c, b), carry._replace(key=key), shuffled)

    return jax.lax.scan(epoch, carry, None, settings.epochs)


def step(task: Task, settings: PPOSettings, carry: Carry) -> tuple[Carry, Transition]:
    """One step of every environment."""
    key, action_key, reset_key = jax.random.split(carry.key, 3)
    inputs = _centred(carry.observations)
    logits = forward(carry.parameters.actor, inputs)
    action = jax.random.categorical(action_key, logits).astype(jnp.int32)
    log_probability = jnp.take_along_axis(jax.nn.log_softmax(logits), action[:, None], axis=1)[:, 0]
    states, outcome = jax.vmap(task.step)(carry.states, action)
    ended = outcome.ended
    fresh = jax.vmap(task.reset)(jax.random.split(reset_key, settings.environments))
    states = jax.tree.map(
        lambda new, old: jnp.where(ended.reshape(-1, *(1,) * (old.ndim - 1)), new, old),
        fresh,
        states,
    )
    value = forward(carry.parameters.critic, inputs)[:, 0]
    reward = outcome.reward[:, 0] * settings.reward_scale
    transition = Transition(carry.observations, action, log_probability, value, reward, ended)
    observations = jax.vmap(task.observe)(states)
    return carry._replace(states=states, observations=observations, key=key), transition


def learn(settings: PPOSettings, carry: Carry, batch: Any) -> tuple[Carry, Array]:
    """One gradient step."""
    steps, advantage = batch
    target = advantage + steps.value
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)

    def loss(parameters: network.Parameters) -> Array:
        inputs = _centred(steps.observation)
        log_probabilities = jax.nn.log_softmax(forward(parameters.actor, inputs))
        chosen = jnp.take_along_axis(log_probabilities, steps.action[:, None], axis=1)[:, 0]
        ratio = jnp.exp(chosen - steps.log_probability)
        clipped = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
        policy = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
        value = forward(parameters.critic, inputs)[:, 0]
        entropy = -(jnp.exp(log_probabilities) * log_probabilities).sum(axis=1).mean()
        error = 0.5 * ((value - target) ** 2).mean()
        return policy + settings.value_coefficient * error - settings.entropy * entropy

    total, gradients = jax.value_and_grad(loss)(carry.parameters)
    with jax.numpy_dtype_promotion("standard"):
        change, optimiser = adam(settings).update(gradients, carry.optimiser, carry.parameters)
    parameters = optax.apply_updates(carry.parameters, change)
    return carry._replace(parameters=parameters, optimiser=optimiser), total


def _centred(observations: Array) -> Array:
    return (observations - 0.5) * 4.0
