"""A learned controller of a sector: one policy for all flights, its bursts stacked.

Before each cycle, with time frozen, the policy is queried for every flight. Of the flights that it
would instruct, the most urgent is served first: the policy is queried for this flight until it
gives no further instruction, and the instructions become one transmission. The other flights are
then queried again, with what has been cleared.
"""

from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.agents.transmission import Transmission
from skystack.learning.inference import Normaliser, forward, normalise
from skystack.learning.policy import Policy
from skystack.simulator.arrivals import FREE
from skystack.simulator.traffic import DIRECT, NO_TURN, Traffic
from skystack.stacking import NO_OP
from skystack.tasks.sector_control import ControlState, SectorControl
from skystack.tasks.sector_observation import SINCE_CYCLES
from skystack.tasks.sector_world import WorldState

MOST_INSTRUCTIONS = 40
"""The maximum number of instructions in a transmission."""


PATIENCE = 0.7
"""A flight is instructed only if the probability that the policy waits is below this. The policy
was trained with sampled actions, where it does not matter in which of a few cycles it acts, nor
which of several good instructions it gives; the most probable single action would often be none."""


class Query(NamedTuple):
    """The answers of the policy for all flights."""

    state: ControlState
    action: Int[Array, " slots"]
    wanted: Bool[Array, " slots"]
    """Whether the action is an instruction that can be issued."""
    rank: Float[Array, " slots"]
    """Seconds until separation would be lost as cleared, plus the probability that the policy
    waits, which breaks ties. The flight with the lowest value is served first."""


class Learned:
    """Implements `skystack.agents.transmission.SectorAgent`.

    `per_cycle` is the maximum number of transmissions in a cycle.
    """

    def __init__(self, policy: Policy, task: SectorControl, per_cycle: int = 1) -> None:
        self.policy, self.task, self.per_cycle = policy, task, per_cycle

    def begin(self, state: WorldState) -> None:
        slots = self.task.agents
        self._flight: Int[np.ndarray, " slots"] = np.full(slots, FREE)
        self._since: Float[np.ndarray, " slots"] = np.full(slots, SINCE_CYCLES, np.float32)

    def transmit(self, state: WorldState) -> list[Transmission]:
        flight = np.asarray(state.arrivals.flight)
        self._since[flight != self._flight] = SINCE_CYCLES
        self._flight = flight.copy()
        begun = self._begin(state, self._since)
        query = self._query(begun)
        sent: list[Transmission] = []
        served: Bool[np.ndarray, " slots"] = np.zeros(len(flight), dtype=bool)
        while len(sent) < self.per_cycle:
            wanted = np.asarray(query.wanted) & ~served
            if not wanted.any():
                break
            slot = int(np.argmin(np.where(wanted, np.asarray(query.rank), np.inf)))
            served[slot] = True
            query = self._stack(query, slot)
            transmission = _transmission(begun, query.state, slot)
            if transmission is not None:
                sent.append(transmission)
                self._since[slot] = 0.0
        self._since = np.minimum(self._since + 1.0, np.float32(SINCE_CYCLES))
        return sent

    @cached_property
    def _begin(self) -> Any:
        return jax.jit(lambda world, since: self.task.begin(world)._replace(since_cycles=since))

    @cached_property
    def _query(self) -> Any:
        return jax.jit(self._ask)

    @cached_property
    def _stack(self) -> Any:
        return jax.jit(self._stack_one)

    def _ask(self, state: ControlState) -> Query:
        """Query the policy for every flight.

        A flight is instructed if the policy would instruct it with a probability above
        1 - `PATIENCE`, or above one half if that continues a transmission; with the instruction
        that is then the most probable one.
        """
        logits = self._logits(self.task.observe(state))
        shape = logits.shape[1:]
        numbers = range(NO_OP + 1, logits.shape[0])
        allowed = jnp.stack(
            [self.task.may_stack(state, jnp.full(shape, each, dtype=jnp.int32)) for each in numbers]
        )
        chances = jax.nn.softmax(
            logits.at[NO_OP + 1 :].set(jnp.where(allowed, logits[NO_OP + 1 :], -jnp.inf)), axis=0
        )
        action = jnp.argmax(chances[NO_OP + 1 :], axis=0).astype(jnp.int32) + NO_OP + 1
        waits = chances[NO_OP]
        wanted = jnp.any(allowed, axis=0) & (waits < jnp.where(state.burst, 0.5, PATIENCE))
        return Query(state, action, wanted, state.outlook.time_s[0] + waits)

    def _stack_one(self, query: Query, slot: Int[Array, ""]) -> Query:
        """Serve one flight: instruct it until the policy gives no further instruction."""
        here = jnp.arange(self.task.agents) == slot

        def wants(carry: tuple[Query, Int[Array, ""]]) -> Bool[Array, ""]:
            query, count = carry
            return query.wanted[slot] & (count < MOST_INSTRUCTIONS)

        def instruct(carry: tuple[Query, Int[Array, ""]]) -> tuple[Query, Int[Array, ""]]:
            query, count = carry
            state = self.task.instruct(query.state, jnp.where(here, query.action, NO_OP))
            return self._ask(state), count + 1

        result: Query = jax.lax.while_loop(wants, instruct, (query, jnp.int32(0)))[0]
        return result

    def _logits(
        self, observation: Float[Array, "observation slots"]
    ) -> Float[Array, "actions slots"]:
        normaliser = Normaliser(*map(jnp.asarray, self.policy.normaliser))
        actor = jax.tree.map(jnp.asarray, self.policy.actor)
        return forward(actor, normalise(normaliser, observation, columns=True), columns=True)


def _transmission(before: ControlState, after: ControlState, slot: int) -> Transmission | None:
    """What a flight is told in all; None if that is nothing."""
    old, new = before.world.traffic, after.world.traffic
    turn = int(new.pending_turn[slot])
    fix = heading = level = None
    if turn == DIRECT and new.cleared_fix is not None:
        fix = int(new.cleared_fix[slot])
    elif turn != NO_TURN:
        heading = _whole_heading(new, slot)
        if heading == _whole_heading(old, slot) and not bool(old.own_navigation[slot]):
            heading = None  # turned back to where it was
    if float(new.cleared_level_ticks[slot]) != float(old.cleared_level_ticks[slot]):
        level = float(new.cleared_level_ticks[slot])
    told = Transmission(slot, heading, fix, level)
    return None if told == Transmission(slot) else told


def _whole_heading(traffic: Traffic, slot: int) -> int:
    return int(np.round(float(traffic.cleared_heading_deg[slot]))) % 360
