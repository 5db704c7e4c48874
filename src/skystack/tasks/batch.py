"""Batches of scenarios, with batch axes last in every array of a task.

Values `[aircraft]` of a scenario become `[aircraft, scenarios]`, scalars become `[scenarios]`. The
last axis is contiguous in memory, so arithmetic runs along the scenarios.
"""

from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Key, PRNGKeyArray

from skystack.tasks.contract import Observation, Outcome, Task, TaskState
from skystack.tasks.wrapper import TaskWrapper

Tree = TypeVar("Tree")


def choose(condition: Bool[Array, "*batch"], yes: Tree, no: Tree) -> Tree:
    """Select from two states, scenario by scenario."""

    def pick(a: Array, b: Array) -> Array:
        return jnp.where(
            condition.reshape((1,) * (a.ndim - condition.ndim) + condition.shape), a, b
        )

    picked: Tree = jax.tree.map(pick, yes, no)
    return picked


def reset_many(task: Task, key: PRNGKeyArray, scenarios: int) -> TaskState:
    """A batch of random scenarios, batch axis last."""
    return reset_each(task, jax.random.split(key, scenarios))


def reset_each(task: Task, keys: Key[Array, " scenarios"]) -> TaskState:
    """One random scenario per key, batch axis last."""
    return jax.vmap(task.reset, out_axes=-1)(keys)


@dataclass(frozen=True)
class OneByOne(TaskWrapper[Task]):
    """Adapts a task written for one scenario to batches, batch axis last. For custom tasks."""

    def observe(self, state: TaskState) -> Observation:
        return jax.vmap(self.task.observe, -1, -1)(state)

    def may_stack(
        self, state: TaskState, action: Int[Array, " scenarios"]
    ) -> Bool[Array, " scenarios"]:
        return jax.vmap(self.task.may_stack, -1, -1)(state, action)

    def instruct(self, state: TaskState, action: Int[Array, " scenarios"]) -> TaskState:
        return jax.vmap(self.task.instruct, -1, -1)(state, action)

    def advance(self, state: TaskState) -> tuple[TaskState, Outcome]:
        return jax.vmap(self.task.advance, -1, -1)(state)

    def step(self, state: TaskState, action: Int[Array, " scenarios"]) -> tuple[TaskState, Outcome]:
        return jax.vmap(self.task.step, -1, -1)(state, action)
