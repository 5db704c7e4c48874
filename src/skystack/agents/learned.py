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

from skystack.agents.transmission import PER_CYCLE, Transmission
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
"""A flight is instructed only if the probability that the policy waits is below this. In training,
actions are sampled, so it hardly matters in which of several cycles an instruction is given, or
which of several good ones it is. The most probable of all actions may then be none in every cycle.
"""


class Answer(NamedTuple):
    """The answers of the policy for some flights."""

    action: Int[Array, " flights"]
    wanted: Bool[Array, " flights"]
    """Whether the policy would instruct the flight, with an instruction that is allowed."""
    waits: Float[Array, " flights"]
    """The probability that the policy gives no instruction."""


class Query(NamedTuple):
    """A state, and the answers of the policy for all flights."""

    state: ControlState
    answer: Answer
    rank: Float[Array, " slots"]
    """Seconds until separation would be lost as cleared, plus the probability that the policy
    waits, which breaks ties. The flight with the lowest value is served first."""


class Learned:
    """Implements `skystack.agents.transmission.SectorAgent`.

    `per_cycle` is the maximum number of transmissions in a cycle.
    """

    def __init__(self, policy: Policy, task: SectorControl, per_cycle: int = PER_CYCLE) -> None:
        self.policy, self.task, self.per_cycle = policy, task, per_cycle

    def begin(self, state: WorldState) -> None:
        slots = self.task.agents
        self._flight: Int[np.ndarray, " slots"] = np.full(slots, FREE)
        self._since: Float[np.ndarray, " slots"] = np.full(slots, SINCE_CYCLES, np.float32)

    def transmit(self, state: WorldState) -> list[Transmission]:
        flight = np.asarray(state.arrivals.flight)
        self._since[flight != self._flight] = SINCE_CYCLES
        self._flight = flight.copy()
        query = self._begin(state, self._since)
        begun = query.state
        sent: list[Transmission] = []
        served: Bool[np.ndarray, " slots"] = np.zeros(len(flight), dtype=bool)
        while len(sent) < self.per_cycle:
            wanted = np.asarray(query.answer.wanted) & ~served
            if not wanted.any():
                break
            slot = int(np.argmin(np.where(wanted, np.asarray(query.rank), np.inf)))
            served[slot] = True
            told = self._stack(query, slot)
            transmission = _transmission(begun, told, slot)
            if transmission is not None:
                sent.append(transmission)
                self._since[slot] = 0.0
            if len(sent) < self.per_cycle:
                query = self._continue(told)
        self._since = np.minimum(self._since + 1.0, np.float32(SINCE_CYCLES))
        return sent

    @cached_property
    def _begin(self) -> Any:
        """(world, since) -> the query before anything is said in a cycle, compiled."""

        def begin(world: WorldState, since: Float[Array, " slots"]) -> Query:
            return self._ask(self.task.begin(world)._replace(since_cycles=since))

        return jax.jit(begin)

    @cached_property
    def _stack(self) -> Any:
        """(query, slot) -> the state after a transmission to a flight, compiled."""
        return jax.jit(self._stack_one)

    @cached_property
    def _continue(self) -> Any:
        """(state) -> the query after a transmission, compiled."""
        return jax.jit(lambda state: self._ask(self.task.with_outlook(state)))

    def _ask(self, state: ControlState) -> Query:
        """Query the policy for every flight."""
        answer = self._answer(self.task.observe(state), self.task.allowed(state), state.burst)
        return Query(state, answer, state.outlook.time_s[0] + answer.waits)

    def _ask_one(self, state: ControlState, slot: Int[Array, ""]) -> Answer:
        """Query the policy for one flight."""
        columns = (self.task.observe(state), self.task.allowed(state), state.burst)
        return self._answer(*(values[..., slot][..., None] for values in columns))

    def _answer(
        self,
        observation: Float[Array, "observation flights"],
        allowed: Bool[Array, "actions flights"],
        burst: Bool[Array, " flights"],
    ) -> Answer:
        """Query the policy for some flights.

        A flight is instructed if the policy would instruct it with a probability above
        1 - `PATIENCE`, or above one half if that continues a transmission; with the instruction
        that is then the most probable one.
        """
        logits = jnp.where(allowed, self._logits(observation), -jnp.inf)
        chances = jax.nn.softmax(logits, axis=0)
        action = jnp.argmax(chances[NO_OP + 1 :], axis=0).astype(jnp.int32) + NO_OP + 1
        waits = chances[NO_OP]
        wanted = jnp.any(allowed[NO_OP + 1 :], axis=0) & (waits < jnp.where(burst, 0.5, PATIENCE))
        return Answer(action, wanted, waits)

    def _stack_one(self, query: Query, slot: Int[Array, ""]) -> ControlState:
        """Serve one flight: instruct it until the policy gives no further instruction.

        In the returned state, only the outlook of this flight is up to date.
        """
        first = Answer(*(values[slot][None] for values in query.answer))
        carry = (query.state, first, jnp.int32(0))

        def wants(carry: tuple[ControlState, Answer, Int[Array, ""]]) -> Bool[Array, ""]:
            _, answer, count = carry
            return answer.wanted[0] & (count < MOST_INSTRUCTIONS)

        def instruct(
            carry: tuple[ControlState, Answer, Int[Array, ""]],
        ) -> tuple[ControlState, Answer, Int[Array, ""]]:
            state, answer, count = carry
            state = self.task.instruct_one(state, slot, answer.action[0])
            return state, self._ask_one(state, slot), count + 1

        result: ControlState = jax.lax.while_loop(wants, instruct, carry)[0]
        return result

    def _logits(
        self, observation: Float[Array, "observation flights"]
    ) -> Float[Array, "actions flights"]:
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
