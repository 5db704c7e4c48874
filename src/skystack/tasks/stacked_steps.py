"""Training with time frozen (ours): a step is an instruction or a radar cycle, never both.

Online action-stacking queries a policy several times within a cycle. A policy trained with one
instruction a cycle meets that only when it is used; with these steps it is trained on it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.simulator.traffic import Traffic
from skystack.tasks.batch import choose
from skystack.tasks.contract import NO_OP, Outcome
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.wrapper import TaskWrapper


class StackedState(NamedTuple):
    """A scenario and the instruction being stacked, NO_OP when none is."""

    inner: NavigationState
    stacking: Int[Array, "*batch"]


@dataclass(frozen=True)
class StackedSteps(TaskWrapper[NavigationTask]):
    """A task whose step gives one more instruction, or else flies one cycle.

    An instruction that would stop the stack (another one than the first of the cycle) is not
    executed, and time goes on, as in `skystack.stacking`. Time goes on in the same step, too, when
    the instruction that was given cannot be given once more.
    """

    @property
    def sector(self) -> Sector:
        return self.task.sector

    def traffic(self, state: StackedState) -> Traffic:
        return self.task.traffic(state.inner)

    def reset(self, key: PRNGKeyArray) -> StackedState:
        return StackedState(self.task.reset(key), jnp.zeros((), dtype=jnp.int32))

    def observe(self, state: StackedState) -> Float[Array, "observation *batch"]:
        return self.task.observe(state.inner)

    def may_stack(self, state: StackedState, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        same = (state.stacking == NO_OP) | (state.stacking == action)
        return (action != NO_OP) & same & self.task.may_stack(state.inner, action)

    def instruct(self, state: StackedState, action: Int[Array, "*batch"]) -> StackedState:
        return StackedState(self.task.instruct(state.inner, action), action)

    def advance(self, state: StackedState) -> tuple[StackedState, Outcome]:
        inner, outcome = self.task.advance(state.inner)
        # A burst ends with the cycle: in the next one the same instruction is a new clearance.
        memory = inner.memory._replace(burst_action=jnp.zeros_like(state.stacking))
        return StackedState(inner._replace(memory=memory), jnp.zeros_like(state.stacking)), outcome

    def step(
        self, state: StackedState, action: Int[Array, "*batch"]
    ) -> tuple[StackedState, Outcome]:
        given = self.may_stack(state, action)
        told = choose(given, self.instruct(state, action), state)
        frozen = given & self.may_stack(told, action)
        flown, outcome = self.advance(told)
        return choose(frozen, told, flown), outcome._replace(
            reward=jnp.where(frozen, 0.0, outcome.reward),
            terminated=outcome.terminated & ~frozen,
            truncated=outcome.truncated & ~frozen,
        )
