"""Collecting transitions with the current policy, several environments at once.

A column is one agent of one environment: all agents share the networks. Tasks with several agents
report which are active.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray, Shaped

from skystack.compilation.chunks import in_chunks
from skystack.learning.advantages import Transitions
from skystack.learning.inference import Normaliser, forward, normalise
from skystack.learning.network import Head, Parameters
from skystack.learning.settings import PPOSettings
from skystack.tasks.batch import choose, reset_each
from skystack.tasks.contract import ManyAgents, Metrics, Outcome, Task, TaskState
from skystack.tasks.observations import flatten_observation

ACTIONS_CHUNK = 256
"""If a task has several agents, the policy evaluates this many observations at once."""


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


class Draws(NamedTuple):
    """The random numbers of a collection."""

    scenarios: Key[Array, " environments"]
    """Keys of the scenarios in reserve."""
    uniforms: Float[Array, "steps columns"]
    """Numbers on [0, 1), which choose the actions."""


class Episodes(NamedTuple):
    """Sums for each environment over its scenarios that ended. Reports divide them by `ended`."""

    ended: Float[Array, " environments"]
    episode_return: Float[Array, " environments"]
    metrics: Metrics


class Collected(NamedTuple):
    """What an update collects, and the train state afterwards."""

    train_state: TrainState
    transitions: Transitions
    episodes: Episodes


class Keys(NamedTuple):
    """The keys of the next update, and the one from which all later keys are split."""

    later: PRNGKeyArray
    collect: PRNGKeyArray
    learn: PRNGKeyArray


def keys_of(train_state: TrainState) -> Keys:
    """Split the key of the train state."""
    return Keys(*jax.random.split(train_state.key, 3))


def draw(task: Task, settings: PPOSettings, train_state: TrainState) -> Draws:
    """Draw the random numbers of the next collection."""
    fresh_key, action_key = jax.random.split(keys_of(train_state).collect)
    # Drawn all at once: drawing random numbers at each step costs more than the policy.
    columns = task.agents * settings.environments
    return Draws(
        jax.random.split(fresh_key, settings.environments),
        jax.random.uniform(action_key, (settings.steps, columns)),
    )


def collect(
    task: Task,
    settings: PPOSettings,
    train_state: TrainState,
    draws: Draws,
    head: Head | None = None,
) -> Collected:
    """Collect a step of each environment for each row of `draws.uniforms`.

    Each environment has one new scenario in reserve, which starts when the current scenario ends.
    If it also ends during the collection, the same scenario starts again.
    """
    fresh = reset_each(task, draws.scenarios)
    fresh_observations = observe_columns(task, fresh)

    def step(
        train_state: TrainState, uniforms: Float[Array, " columns"]
    ) -> tuple[TrainState, tuple[Transitions, Episodes]]:
        observation = train_state.observations
        active, waiting = _deciding(task, train_state.scenarios)
        log_probabilities = of_wanted(
            partial(_policy, train_state, head),
            len(task.action_names),
            observation,
            active,
            ACTIONS_CHUNK,
        )
        action = sample_actions(log_probabilities, uniforms)
        scenarios, outcome = task.step(train_state.scenarios, _by_agent(task, action))
        final_observation = observe_columns(task, scenarios)
        reward, ended = outcome.reward.reshape(-1), outcome.ended
        returns = train_state.returns + jnp.sum(outcome.reward, axis=0)
        transition = Transitions(
            observation=observation,
            final_observation=final_observation,
            action=action,
            log_probability=select(log_probabilities, action),
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
        return train_state, (transition, _of_ended(ended, returns, outcome))

    train_state, (transitions, episodes) = jax.lax.scan(step, train_state, draws.uniforms)
    return Collected(train_state, transitions, jax.tree.map(partial(jnp.sum, axis=0), episodes))


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


def _policy(
    train_state: TrainState, head: Head | None, observation: Float[Array, "observation n"]
) -> Float[Array, "actions n"]:
    """The logarithms of the probabilities of the actions."""
    normalised = normalise(train_state.normaliser, observation, columns=True)
    return log_probabilities_of(train_state.parameters, normalised, head)


def of_wanted(
    function: Callable[[Float[Array, "observation n"]], Float[Array, "outputs n"]],
    outputs: int,
    columns: Float[Array, "observation columns"],
    wanted: Bool[Array, " columns"] | None,
    chunk: int,
) -> Float[Array, "outputs columns"]:
    """The function of the wanted columns, and zero for the others. None: all are wanted."""
    if wanted is None:
        return function(columns)
    nothing = jnp.zeros((outputs, columns.shape[1]))
    return in_chunks(wanted, lambda column: function(columns[:, column]), nothing, chunk)


def observe_columns(task: Task, scenarios: TaskState) -> Float[Array, "observation columns"]:
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


def log_probabilities_of(
    parameters: Parameters, observation: Float[Array, "observation n"], head: Head | None
) -> Float[Array, "actions n"]:
    """The logarithms of the probabilities of the actions, for normalised observations."""
    outputs = forward(parameters.actor, observation, columns=True)
    return jax.nn.log_softmax(outputs if head is None else head.logits(outputs), axis=0)


def select(
    log_probabilities: Float[Array, "actions n"], action: Int[Array, " n"]
) -> Float[Array, " n"]:
    """The entry of the action taken, of each column."""
    taken = jnp.arange(log_probabilities.shape[0])[:, None] == action[None, :]
    return jnp.sum(jnp.where(taken, log_probabilities, 0.0), axis=0)


def _of_ended(
    ended: Bool[Array, " environments"], returns: Float[Array, " environments"], outcome: Outcome
) -> Episodes:
    """The values of the scenarios that ended; zero for the others."""

    def counted(values: Array) -> Array:
        return jnp.where(ended, values.astype(jnp.float32), 0.0)

    return Episodes(
        ended.astype(jnp.float32), counted(returns), jax.tree.map(counted, outcome.metrics)
    )
