"""Training of sector control with frozen time: rounds of instructions, then a radar cycle.

The learned controller compiles several instructions to a flight into one transmission before each
cycle (`skystack.agents.learned`). These steps train it in the same way. In the first round of a
cycle, every flight decides; in further rounds, only those that were instructed in the previous
round. When no flight is instructed, or after `ROUNDS` rounds, the cycle is flown.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.stacking import NO_OP
from skystack.tasks.batch import choose
from skystack.tasks.contract import Outcome
from skystack.tasks.sector_control import ControlState, SectorControl
from skystack.tasks.wrapper import TaskWrapper

ROUNDS = 20
"""The maximum number of rounds with instructions in a cycle: enough for a turn of 180 degrees."""


class RoundState(NamedTuple):
    """A sector, and which flights decide next."""

    inner: ControlState
    decides: Bool[Array, "slots *batch"]
    rounds: Int[Array, "*batch"]
    """The number of rounds so far in this cycle."""


@dataclass(frozen=True)
class SectorStacks(TaskWrapper[SectorControl]):
    """Sector control whose step is a round of instructions, or a cycle.

    Implements `skystack.tasks.contract.ManyAgents`. The cost of a transmission is part of the
    reward of the cycle.
    """

    def reset(self, key: PRNGKeyArray) -> RoundState:
        inner = self.task.reset(key)
        return RoundState(inner, self.task.active(inner), jnp.zeros((), dtype=jnp.int32))

    def observe(self, state: RoundState) -> Float[Array, "observation slots *batch"]:
        return self.task.observe(state.inner)

    def active(self, state: RoundState) -> Bool[Array, "slots *batch"]:
        return state.decides

    def waiting(self, state: RoundState) -> Bool[Array, "slots *batch"]:
        """The flights that have finished in this cycle; they decide again in the next one."""
        return self.task.active(state.inner) & ~state.decides

    def may_stack(
        self, state: RoundState, action: Int[Array, "slots *batch"]
    ) -> Bool[Array, "slots *batch"]:
        return state.decides & self.task.may_stack(state.inner, action)

    def instruct(self, state: RoundState, action: Int[Array, "slots *batch"]) -> RoundState:
        told = self.may_stack(state, action)
        inner = self.task.instruct(state.inner, jnp.where(told, action, NO_OP))
        return RoundState(inner, told, state.rounds + 1)

    def advance(self, state: RoundState) -> tuple[RoundState, Outcome]:
        inner, outcome = self.task.advance(state.inner)
        # A stack ends with the cycle: in the next one, an instruction begins a new transmission.
        inner = self.task.end_burst(inner)
        return RoundState(inner, self.task.active(inner), jnp.zeros_like(state.rounds)), outcome

    def step(
        self, state: RoundState, action: Int[Array, "slots *batch"]
    ) -> tuple[RoundState, Outcome]:
        """`instruct` where flights are instructed, else `advance`."""
        told = self.may_stack(state, action) & (state.rounds < ROUNDS)[None]
        frozen = jnp.any(told, axis=0)
        before, world = state.inner, self.task.world
        instructed = self.task.told(before, jnp.where(told, action, NO_OP))
        flown_world, flown = world.advance(before.world)
        decides = jnp.where(frozen[None], told, flown_world.hears)
        # To save time, one outlook serves both cases, and only for the flights that decide next.
        next_world = choose(frozen, instructed.world, flown_world)
        outlook = world.look_ahead(next_world, flights=decides, before=before.outlook)
        flown_state, outcome = self.task.end_cycle(before, flown_world, flown, outlook)
        flown_state = self.task.end_burst(flown_state)
        inner = choose(frozen, instructed._replace(outlook=outlook), flown_state)
        return (
            RoundState(inner, decides, jnp.where(frozen, state.rounds + 1, 0)),
            Outcome(
                reward=jnp.where(frozen[None], 0.0, outcome.reward),
                terminated=outcome.terminated & ~frozen[None],
                truncated=outcome.truncated & ~frozen[None],
                ended=outcome.ended & ~frozen,
                metrics=outcome.metrics,
                steps=jnp.where(frozen, 0.0, 1.0),
            ),
        )
