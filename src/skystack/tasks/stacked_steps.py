"""Training with frozen time (not in the paper): instructions and radar cycles are separate.

Online action-stacking queries a policy several times per cycle. A policy trained with one
instruction per cycle experiences this only at inference. With these steps it also experiences it in
training.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.simulator.traffic import Traffic
from skystack.stacking import Stack, belongs
from skystack.tasks.batch import choose
from skystack.tasks.contract import Observation, Outcome, TaskState
from skystack.tasks.wrapper import TaskWrapper


class StackedState(NamedTuple):
    """A scenario and the stack of the current cycle."""

    inner: TaskState
    stack: Stack


@dataclass(frozen=True)
class StackedSteps(TaskWrapper[Any]):
    """A task whose step adds an instruction to the stack, or flies a cycle if the stack ends.

    As in `skystack.stacking`, an action that differs from the first of the cycle ends the stack: it
    is not executed, and the cycle is flown. If an instruction is executed and cannot be repeated,
    the cycle is flown in the same step.
    """

    @property
    def sector(self) -> Sector:
        return self.task.sector

    def traffic(self, state: StackedState) -> Traffic:
        return self.task.traffic(state.inner)

    def reset(self, key: PRNGKeyArray) -> StackedState:
        return _begin_cycle(self.task.reset(key), jnp.zeros((), dtype=jnp.int32))

    def observe(self, state: StackedState) -> Observation:
        return self.task.observe(state.inner)

    def may_stack(self, state: StackedState, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        return belongs(action, state.stack) & self.task.may_stack(state.inner, action)

    def instruct(self, state: StackedState, action: Int[Array, "*batch"]) -> StackedState:
        stack = Stack(action, state.stack.instructions + 1)
        return StackedState(self.task.instruct(state.inner, action), stack)

    def advance(self, state: StackedState) -> tuple[StackedState, Outcome]:
        inner, outcome = self.task.advance(state.inner)
        # A burst ends with the cycle: in the next one the same instruction is a new clearance.
        end_burst = getattr(self.task, "end_burst", lambda inner: inner)
        return _begin_cycle(end_burst(inner), jnp.zeros_like(state.stack.action)), outcome

    def step(
        self, state: StackedState, action: Int[Array, "*batch"]
    ) -> tuple[StackedState, Outcome]:
        executed = self.may_stack(state, action)
        instructed = choose(executed, self.instruct(state, action), state)
        frozen = executed & self.may_stack(instructed, action)
        flown, outcome = self.advance(instructed)
        return choose(frozen, instructed, flown), Outcome(
            reward=jnp.where(frozen[None], 0.0, outcome.reward),
            terminated=outcome.terminated & ~frozen[None],
            truncated=outcome.truncated & ~frozen[None],
            ended=outcome.ended & ~frozen,
            metrics=outcome.metrics,
        )


def _begin_cycle(inner: TaskState, zero: Int[Array, "*batch"]) -> StackedState:
    return StackedState(inner, Stack(zero, zero))
