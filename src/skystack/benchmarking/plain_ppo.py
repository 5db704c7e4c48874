"""PPO as PureJaxRL writes it, on our task: what the trainer would be without its own tricks.

The same algorithm and sizes as `skystack.learning.ppo`, plainly: scenarios vmapped along the first
axis, a key for every step, a categorical distribution sampled by Gumbel noise, a fresh scenario
drawn for everybody in every step, values carried along, the batch shuffled by a permutation of
every array. For measuring speed; observations are normalised by fixed constants.
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
    """A learner in fresh scenarios."""
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
    """Collect, judge, learn."""
    carry, steps = jax.lax.scan(lambda c, _: step(task, settings, c), carry, None, settings.steps)
    last = forward(carry.parameters.critic, _centred(carry.observations))[:, 0]

    def back(later: tuple[Array, Array], now: Transition) -> tuple[tuple[Array, Array], Array]:
        advantage, next_value = later
        goes_on = 1.0 - now.ended.astype(jnp.float32)
        error = now.reward + settings.gamma * next_value * goes_on - now.value
        advantage = error + settings.gamma * settings.gae_lambda * goes_on * advantage
        return (advantage, now.value), advantage

    _, advantages = jax.lax.scan(back, (jnp.zeros_like(last), last), steps, reverse=True)
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
    seen = _centred(carry.observations)
    logits = forward(carry.parameters.actor, seen)
    action = jax.random.categorical(action_key, logits).astype(jnp.int32)
    chosen = jnp.take_along_axis(jax.nn.log_softmax(logits), action[:, None], axis=1)[:, 0]
    states, outcome = jax.vmap(task.step)(carry.states, action)
    ended = outcome.terminated | outcome.truncated
    fresh = jax.vmap(task.reset)(jax.random.split(reset_key, settings.environments))
    states = jax.tree.map(
        lambda new, old: jnp.where(ended.reshape(-1, *(1,) * (old.ndim - 1)), new, old),
        fresh,
        states,
    )
    value = forward(carry.parameters.critic, seen)[:, 0]
    reward = outcome.reward * settings.reward_scale
    taken = Transition(carry.observations, action, chosen, value, reward, ended)
    observations = jax.vmap(task.observe)(states)
    return carry._replace(states=states, observations=observations, key=key), taken


def learn(settings: PPOSettings, carry: Carry, batch: Any) -> tuple[Carry, Array]:
    """One gradient step."""
    steps, advantage = batch
    target = advantage + steps.value
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)

    def loss(parameters: network.Parameters) -> Array:
        seen = _centred(steps.observation)
        logarithms = jax.nn.log_softmax(forward(parameters.actor, seen))
        chosen = jnp.take_along_axis(logarithms, steps.action[:, None], axis=1)[:, 0]
        ratio = jnp.exp(chosen - steps.log_probability)
        clipped = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
        policy = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
        value = forward(parameters.critic, seen)[:, 0]
        entropy = -(jnp.exp(logarithms) * logarithms).sum(axis=1).mean()
        error = 0.5 * ((value - target) ** 2).mean()
        return policy + settings.value_coefficient * error - settings.entropy * entropy

    total, gradients = jax.value_and_grad(loss)(carry.parameters)
    with jax.numpy_dtype_promotion("standard"):
        change, optimiser = adam(settings).update(gradients, carry.optimiser, carry.parameters)
    parameters = optax.apply_updates(carry.parameters, change)
    return carry._replace(parameters=parameters, optimiser=optimiser), total


def _centred(observations: Array) -> Array:
    return (observations - 0.5) * 4.0
