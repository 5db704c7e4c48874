"""Fly scenarios with an agent that runs in Python: all scenarios at once, cycle by cycle.

The task's functions are compiled for all scenarios together, and the agent is called between them.
The results equal those of `skystack.evaluation.rollout`, which compiles the whole loop and so
cannot include such an agent.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from skystack.agents.agent import Agent
from skystack.agents.queries import QueryNames, query_actions, query_scores
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.evaluation.rollout import (
    Recording,
    begin,
    blocks,
    fly_cycle,
    initial_fields,
    recording_of,
    scenarios_first,
)
from skystack.learning.seeds import scenario_keys
from skystack.stacking import NO_OP, Stack, stack_many
from skystack.tasks.batch import choose
from skystack.tasks.contract import TaskState, TrafficTask
from skystack.tasks.observations import flatten_observation


class AgentController(NamedTuple):
    """An agent and how it decides: by its greedy action, or by sampling from its logits."""

    agent: Agent
    greedy: bool = True


class QueryContext(NamedTuple):
    """A cycle of some scenarios, in which an agent decides."""

    numbers: Int[np.ndarray, " scenarios"]
    cycle: int
    keys: Key[Array, " scenarios"]
    """Random keys, for an agent that samples."""


class Decisions:
    """Online action-stacking of an agent for many scenarios at once; batch axis last.

    Implements `skystack.stacking.ManyTwoPhase`.
    """

    def __init__(self, task: TrafficTask, controller: AgentController, limit: int | None) -> None:
        self._controller, self._limit = controller, limit
        self._actions = len(task.action_names)
        self.may_stack = shared_program(task.may_stack)
        self.instruct = shared_program(task.instruct)
        self.choose, self._sample = shared_program(choose), shared_program(_sample_many)
        self._observe = shared_program(_flat_observation, task)

    def observe(self, state: TaskState) -> Float[np.ndarray, "scenarios observation"]:
        """The flattened observations, scenarios first."""
        return np.asarray(self._observe(state)).T

    def decide(
        self, state: TaskState, asking: Bool[np.ndarray, " scenarios"], moment: QueryContext
    ) -> tuple[TaskState, Stack]:
        """Issue the agent's instructions in the scenarios of a mask; no simulated time passes.

        Raises InputError as `skystack.agents.queries.query_actions` does.
        """

        def policy(observations: Any, asking: Any, query: Any) -> Int[np.ndarray, " scenarios"]:
            asked = np.flatnonzero(asking)
            actions = np.full(len(moment.numbers), NO_OP, dtype=np.int32)
            # Indexing copies the observations: the agent may keep or change them.
            actions[asked] = self._query(observations[asked], asked, query, moment)
            return actions

        return stack_many(self, policy, state, asking, self._limit)

    def _query(
        self,
        observations: Float[np.ndarray, "asking observation"],
        asked: Int[np.ndarray, " asking"],
        query: Any,
        moment: QueryContext,
    ) -> Int[np.ndarray, " asking"]:
        agent, greedy = self._controller
        query_agent = query_actions if greedy else query_scores
        names = QueryNames(moment.numbers[asked].tolist(), moment.cycle)
        answers = query_agent(agent, observations, names, self._actions)
        if greedy:
            return answers
        logits = np.zeros((len(moment.numbers), self._actions), dtype=np.float32)
        logits[asked] = answers  # always one row per scenario: a single shape to compile
        return np.asarray(self._sample(moment.keys, query, logits))[asked]


def _flat_observation(task: TrafficTask, state: TaskState) -> Float[Array, "observation scenarios"]:
    return flatten_observation(task.observe(state), batch_axes=1)


def _sample(
    key: Key[Array, ""], query: Int[Array, ""], logits: Float[Array, " actions"]
) -> Int[Array, ""]:
    """Sample with the same keys as the compiled rollout, so that results are equal."""
    return jax.random.categorical(jax.random.fold_in(key, query), logits)


def _sample_many(
    keys: Key[Array, " scenarios"],
    queries: Int[Array, " scenarios"],
    logits: Float[Array, "scenarios actions"],
) -> Int[Array, " scenarios"]:
    return jax.vmap(_sample)(keys, queries, logits)


def fly_with_agent(
    task: TrafficTask,
    controller: AgentController,
    seed: int,
    scenarios: int,
    stacking: bool,
) -> Iterator[Recording]:
    """`skystack.evaluation.rollout.fly` for an agent, block by block.

    Raises InputError, which names scenario and cycle, for an agent that fails or returns an action
    that is not in the task's action table.
    """
    rollout, decisions = _Rollout(task), Decisions(task, controller, None if stacking else 1)
    for numbers in blocks(task, scenarios):
        yield rollout.fly(decisions, seed, numbers)


class _Rollout:
    """The compiled parts of the loop, shared by all blocks."""

    def __init__(self, task: TrafficTask) -> None:
        self._task = task
        self._begin = shared_program(begin, task)
        self._advance = shared_program(_advance, task)

    def fly(
        self, decisions: Decisions, seed: int, numbers: Int[np.ndarray, " scenarios"]
    ) -> Recording:
        """Fly scenarios until all have ended; a scenario that has ended does not change."""
        keys = scenario_keys(seed, numbers)
        state, query_keys = self._begin(keys)
        start = fetched(scenarios_first(initial_fields(self._task, state)))
        over, rows = np.zeros(len(numbers), dtype=bool), list[Any]()
        while not over.all():
            moment = QueryContext(numbers, len(rows), query_keys[len(rows)])
            instructed, stack = decisions.decide(state, ~over, moment)
            state, ended, row = self._advance(instructed, stack, over)
            over = np.asarray(ended)
            rows.append(fetched(row))
        return recording_of(numbers, start, rows, self._task.cycles)


def _advance(
    task: TrafficTask, instructed: TaskState, stack: Stack, over: Bool[Array, " scenarios"]
) -> tuple[TaskState, Bool[Array, " scenarios"], tuple[Any, ...]]:
    state, over, row = fly_cycle(task, instructed, stack, over)
    return state, over, scenarios_first(row)
