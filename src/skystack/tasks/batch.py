"""Many scenarios at once: batch axes come last in every array of a task.

A scenario's values `[aircraft]` become `[aircraft, scenarios]`, its scalars `[scenarios]`. The last
axis is contiguous in memory, so that all arithmetic runs along scenarios.
"""

from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.tasks.contract import Outcome, Task, TaskState
from skystack.tasks.wrapper import TaskWrapper

Tree = TypeVar("Tree")


def choose(condition: Bool[Array, "*batch"], yes: Tree, no: Tree) -> Tree:
    """One of two states for each scenario."""

    def pick(a: Array, b: Array) -> Array:
        return jnp.where(
            condition.reshape((1,) * (a.ndim - condition.ndim) + condition.shape), a, b
        )

    picked: Tree = jax.tree.map(pick, yes, no)
    return picked


def reset_many(task: Task, key: PRNGKeyArray, scenarios: int) -> TaskState:
    """Random scenarios, batch axis last."""
    return jax.vmap(task.reset, out_axes=-1)(jax.random.split(key, scenarios))


@dataclass(frozen=True)
class OneByOne(TaskWrapper[Task]):
    """Makes a task that is written for one scenario take a batch, axis last: for users' tasks."""

    def reset(self, key: PRNGKeyArray) -> TaskState:
        return self.task.reset(key)

    def observe(self, state: TaskState) -> Float[Array, "observation scenarios"]:
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
