"""Fly scenarios under an agent that is asked from Python: all at once, cycle by cycle.

The task's parts are compiled, each for all scenarios together; between them the agent is asked. The
results are those of `skystack.evaluation.rollout`, whose one program no such agent can be part of.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from skystack.agents.agent import Agent
from skystack.agents.queries import query_actions, query_scores
from skystack.evaluation.rollout import (
    Recording,
    blocks,
    keep,
    query_keys,
    recording_of,
)
from skystack.learning.seeds import scenario_keys
from skystack.stacking import Stack, stack_many
from skystack.tasks.batch import choose
from skystack.tasks.contract import NO_OP
from skystack.tasks.navigation import NavigationState, NavigationTask


class HostedController(NamedTuple):
    """An agent and how it decides: by its action, or by one drawn by its logits."""

    agent: Agent
    greedy: bool = True


class Moment(NamedTuple):
    """A cycle of some scenarios, in which an agent decides."""

    numbers: Int[np.ndarray, " scenarios"]
    cycle: int
    keys: Key[Array, " scenarios"]
    """For an agent that samples."""


class Decisions:
    """Online action-stacking of an agent for many scenarios at once; batch axis last.

    Implements `skystack.stacking.ManyTwoPhase`.
    """

    def __init__(
        self, task: NavigationTask, controller: HostedController, limit: int | None
    ) -> None:
        self._controller, self._limit = controller, limit
        self._actions = len(task.action_names)
        self.may_stack, self.instruct = jax.jit(task.may_stack), jax.jit(task.instruct)
        self.choose, self._observed = jax.jit(choose), jax.jit(task.observe)
        self._drawn = jax.jit(jax.vmap(_drawn))

    def observe(self, state: NavigationState) -> Float[np.ndarray, "scenarios observation"]:
        return np.asarray(self._observed(state)).T

    def decide(
        self, state: NavigationState, asking: Bool[np.ndarray, " scenarios"], moment: Moment
    ) -> tuple[NavigationState, Stack]:
        """Instruct as the agent asks, in the scenarios of a mask; no time passes.

        Raises InputError as `skystack.agents.queries.query_actions` does.
        """

        def policy(observations: Any, asking: Any, query: Any) -> Int[np.ndarray, " scenarios"]:
            who = np.flatnonzero(asking)
            actions = np.full(len(moment.numbers), NO_OP, dtype=np.int32)
            # Taken by their indices, observations are a copy: the agent may keep or change them.
            actions[who] = self._ask(observations[who], who, query, moment)
            return actions

        return stack_many(self, policy, state, asking, self._limit)

    def _ask(
        self,
        observations: Float[np.ndarray, "asking observation"],
        who: Int[np.ndarray, " asking"],
        query: Any,
        moment: Moment,
    ) -> Int[np.ndarray, " asking"]:
        agent, greedy = self._controller
        ask = query_actions if greedy else query_scores
        answers = ask(agent, observations, moment.numbers[who], moment.cycle, self._actions)
        if greedy:
            return answers
        logits = np.zeros((len(moment.numbers), self._actions), dtype=np.float32)
        logits[who] = answers  # all scenarios in one shape, which is compiled once
        return np.asarray(self._drawn(moment.keys, query, logits))[who]


def _drawn(
    key: Key[Array, ""], query: Int[Array, ""], logits: Float[Array, " actions"]
) -> Int[Array, ""]:
    """Under the same keys as inside a compiled program: the same agent draws the same."""
    return jax.random.categorical(jax.random.fold_in(key, query), logits)


def fly_hosted(
    task: NavigationTask,
    controller: HostedController,
    seed: int,
    scenarios: int,
    stacking: bool,
) -> Iterator[Recording]:
    """`skystack.evaluation.rollout.fly` for an agent, block by block.

    Raises InputError, which names scenario and cycle, for an agent that fails or answers with what
    is not in the task's action table.
    """
    flight, decisions = _Flight(task), Decisions(task, controller, None if stacking else 1)
    for numbers in blocks(task, scenarios):
        yield flight.fly(decisions, seed, numbers)


class _Flight:
    """The compiled parts of a flight, shared by all blocks."""

    def __init__(self, task: NavigationTask) -> None:
        self._task = task
        self._reset = jax.jit(jax.vmap(task.reset, out_axes=-1))
        self._queries = jax.jit(jax.vmap(partial(query_keys, task)))
        self._advance = jax.jit(self._advanced)

    def _advanced(
        self, told: NavigationState, stack: Stack, over: Bool[Array, " scenarios"]
    ) -> tuple[NavigationState, Bool[Array, " scenarios"], tuple[Any, ...]]:
        flown, outcome = self._task.advance(told)
        state = choose(over, told, flown)
        kept = keep(stack, state, outcome, over)
        return state, over | outcome.terminated, _first(kept)

    def fly(
        self, decisions: Decisions, seed: int, numbers: Int[np.ndarray, " scenarios"]
    ) -> Recording:
        """Fly scenarios until the last has ended; those that have ended do not change."""
        keys = scenario_keys(seed, numbers)
        state, queries = self._reset(keys), self._queries(keys)
        start, exit_level_ticks = jax.device_get(
            _first((state.traffic, state.memory.exit_level_ticks))
        )
        over, rows = np.zeros(len(numbers), dtype=bool), list[Any]()
        while not over.all():
            moment = Moment(numbers, len(rows), queries[:, len(rows)])
            told, stack = decisions.decide(state, ~over, moment)
            state, ended, kept = self._advance(told, stack, over)
            over = np.asarray(ended)
            rows.append(jax.device_get(kept))
        return recording_of(numbers, start, exit_level_ticks, rows, self._task.settings.cycles)


def _first(tree: Any) -> Any:
    """With the axis of scenarios first."""
    return jax.tree.map(lambda values: jnp.moveaxis(values, -1, 0), tree)
