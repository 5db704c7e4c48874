"""A learned controller of a sector: one policy for all flights, its bursts stacked.

Before each cycle, with time frozen, the policy is queried for every flight. Of the flights that it
would instruct, the most urgent is served first: the policy is queried for this flight until it
gives no further instruction, and the instructions become one transmission. The other flights are
then queried again, with what has been cleared. A safety net acts on predicted losses of separation
and excursions (`skystack.agents.safety_net`).
"""

from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.agents.safety_net import alerts, lasts_s, way_out
from skystack.agents.since import SinceTransmission
from skystack.agents.transmission import (
    MOST_INSTRUCTIONS,
    PER_CYCLE,
    Transmission,
    clearance_of,
    transmission_between,
)
from skystack.learning.inference import forward, normalise
from skystack.learning.policy import Policy
from skystack.simulator.traffic import Clearance
from skystack.stacking import NO_OP
from skystack.tasks.outlook import CLEARED
from skystack.tasks.sector_control import ControlState, SectorControl
from skystack.tasks.sector_world import WorldState

PATIENCE = 0.7
"""A flight is instructed only if the probability that the policy waits is below this. In training,
actions are sampled, so it hardly matters in which of several cycles an instruction is given, or
which of several good ones it is. The most probable of all actions may then be none in every cycle.
"""


Weights = Any
"""(normaliser, actor) of a policy; in a subclass, whatever its `_logits` takes."""


class Answer(NamedTuple):
    """The answers of the policy for some flights."""

    action: Int[Array, " flights"]
    wanted: Bool[Array, " flights"]
    """Whether the policy would instruct the flight, with an instruction that is allowed."""
    waits: Float[Array, " flights"]
    """The probability that the policy gives no instruction."""


class Certainty(NamedTuple):
    """How certain a policy is about a flight."""

    probability: float
    """That it gives an instruction now."""
    entropy: float
    """Of its choice among the allowed actions, from 0 (certain) to 1 (all equally likely)."""


class Query(NamedTuple):
    """A state, and the answers of the policy for all flights."""

    state: ControlState
    answer: Answer
    margin_s: Float[Array, " slots"]
    """See `_margin_s`. The flight with the smallest margin is served first."""


class _Visited(NamedTuple):
    """The clearances that a flight has had in a burst, to detect when the burst repeats itself."""

    clearance: Float[Array, "most parts"]
    """Row k: the clearance after k instructions; NaN in rows that are not reached yet."""
    margin_s: Float[Array, " most"]
    """See `_margin_s`."""
    kept: Int[Array, ""]
    """The index of the clearance to keep, once the burst repeats itself; before that, -1."""

    @classmethod
    def begin(cls, clearance: Float[Array, " parts"], margin_s: Float[Array, ""]) -> "_Visited":
        """A record of only the clearance before the burst."""
        most = MOST_INSTRUCTIONS + 1
        empty = jnp.full((most, len(clearance)), jnp.nan, dtype=jnp.float32)
        return cls(empty, jnp.zeros(most), jnp.int32(-1)).add(jnp.int32(0), clearance, margin_s)

    def add(
        self,
        count: Int[Array, ""],
        clearance: Float[Array, " parts"],
        margin_s: Float[Array, ""],
    ) -> "_Visited":
        """Record the clearance after `count` instructions."""
        before = jnp.all(self.clearance == clearance[None], axis=1)
        index = jnp.arange(len(before), dtype=jnp.int32)
        repeated = (index >= jnp.argmax(before).astype(jnp.int32)) & (index < count)
        best = jnp.argmax(jnp.where(repeated, self.margin_s, -1.0)).astype(jnp.int32)
        begins = (self.kept < 0) & jnp.any(before)
        return _Visited(
            self.clearance.at[count].set(clearance),
            self.margin_s.at[count].set(margin_s),
            jnp.where(begins, best, self.kept),
        )

    def is_kept(self, clearance: Float[Array, " parts"]) -> Bool[Array, ""]:
        """Whether a clearance is the one to keep."""
        return (self.kept >= 0) & jnp.all(self.clearance[self.kept] == clearance)


class _FlightBurst(NamedTuple):
    """The instructions to a flight so far, and the answer to what has been cleared."""

    state: ControlState
    answer: Answer
    number: Int[Array, ""]
    visited: _Visited


class Learned:
    """Implements `skystack.agents.transmission.SectorAgent`.

    `per_cycle` is the maximum number of transmissions in a cycle. `safety_net` turns on the safety
    net (`skystack.agents.safety_net`).
    """

    def __init__(
        self,
        policy: Policy,
        task: SectorControl,
        per_cycle: int = PER_CYCLE,
        safety_net: bool = True,
    ) -> None:
        self.policy, self.task = policy, task
        self.per_cycle, self.safety_net = per_cycle, safety_net
        # They are arguments of the compiled programs, so policies of the same shape share these.
        self._weights: Weights = jax.tree.map(jnp.asarray, (policy.normaliser, policy.actor))

    def begin(self, state: WorldState) -> None:
        self._since = SinceTransmission(self.task.agents)

    def transmit(self, state: WorldState) -> list[Transmission]:
        query = self._begin(self._weights, state, self._since.cycles(state))
        begun = query.state
        sent: list[Transmission] = []
        unserved: Bool[np.ndarray, " slots"] = np.array(state.hears)
        while len(sent) < self.per_cycle:
            wanted = unserved & self._wanted(query)
            if not wanted.any():
                break
            slot = int(np.argmin(np.where(wanted, np.asarray(query.margin_s), np.inf)))
            unserved[slot] = False
            told, instructions = self._serve(query, slot)
            transmission = transmission_between(
                begun.world.traffic, told.world.traffic, slot, instructions
            )
            if transmission is None:
                continue
            sent.append(transmission)
            if len(sent) < self.per_cycle:
                query = self._continue(self._weights, told)
        self._since.end_cycle(sent)
        return sent

    def certainty(self, state: WorldState, slot: int) -> Certainty:
        """How certain the policy is about the flight in a slot, before anything is transmitted."""
        since = self._since.cycles(state)
        probability, entropy = self._certainty(self._weights, state, since, slot)
        return Certainty(float(probability), float(entropy))

    @cached_property
    def _certainty(self) -> Any:
        """(weights, world, since, slot) -> the values of `Certainty`, compiled."""

        def certainty(
            weights: Weights, world: WorldState, since: Float[Array, " slots"], slot: Int[Array, ""]
        ) -> tuple[Float[Array, ""], Float[Array, ""]]:
            state = self.task.begin(world)._replace(since_cycles=since)
            allowed = self.task.allowed(state)[:, slot]
            logits = self._logits(weights, self.task.observe(state)[:, slot][:, None])[:, 0]
            chances = jax.nn.softmax(jnp.where(allowed, logits, -jnp.inf))
            most = jnp.log(jnp.maximum(jnp.sum(allowed.astype(jnp.float32)), 2.0))
            entropy = -jnp.sum(jax.scipy.special.xlogy(chances, chances)) / most
            return 1.0 - chances[NO_OP], entropy

        return jax.jit(certainty)

    def _wanted(self, query: Query) -> Bool[np.ndarray, " slots"]:
        """The flights that the policy would instruct, or that the safety net may have to."""
        wanted = np.asarray(query.answer.wanted)
        if not self.safety_net:
            return wanted
        return wanted | alerts(query.state.outlook)

    def _serve(self, query: Query, slot: int) -> tuple[ControlState, int]:
        """The state after a transmission to a flight, and the number of instructions in it."""
        told, count = self._stack(self._weights, query, slot)
        instructions = int(count)
        if not (self.safety_net and alerts(told.outlook)[slot]):
            return told, instructions
        if not alerts(query.state.outlook)[slot]:
            return query.state, 0  # there is no alert without the instructions
        time_s = lasts_s(told.outlook)[:, slot]
        way = way_out(self.task.sector, told.world, slot, time_s)
        if way is not None:
            return self._rescue(told, clearance_of([way], self.task.agents)), instructions + 1
        before_s = lasts_s(query.state.outlook)[CLEARED, slot]
        return (query.state, 0) if time_s[CLEARED] < before_s else (told, instructions)

    @cached_property
    def _rescue(self) -> Any:
        """(state, clearance) -> the state after a clearance of the safety net, compiled."""

        def rescue(state: ControlState, clearance: Clearance) -> ControlState:
            return state._replace(world=self.task.world.instruct(state.world, clearance))

        return jax.jit(rescue)

    @cached_property
    def _begin(self) -> Any:
        """(weights, world, since) -> the query before anything is said in a cycle, compiled."""

        def begin(weights: Weights, world: WorldState, since: Float[Array, " slots"]) -> Query:
            return self._ask(weights, self.task.begin(world)._replace(since_cycles=since))

        return jax.jit(begin)

    @cached_property
    def _stack(self) -> Any:
        """(weights, query, slot) -> the state after a transmission to a flight, and the number of
        instructions in it, compiled."""
        return jax.jit(self._stack_one)

    @cached_property
    def _continue(self) -> Any:
        """(weights, state) -> the query after a transmission, compiled."""
        return jax.jit(lambda weights, state: self._ask(weights, self.task.with_outlook(state)))

    def _ask(self, weights: Weights, state: ControlState) -> Query:
        """Query the policy for every flight."""
        columns = (self.task.observe(state), self.task.allowed(state), state.burst)
        answer = self._answer(weights, *columns)
        return Query(state, answer, _margin_s(state.outlook.time_s[CLEARED], answer.waits))

    def _ask_one(self, weights: Weights, state: ControlState, slot: Int[Array, ""]) -> Answer:
        """Query the policy for one flight."""
        columns = (self.task.observe(state), self.task.allowed(state), state.burst)
        return self._answer(weights, *(values[..., slot][..., None] for values in columns))

    def _answer(
        self,
        weights: Weights,
        observation: Float[Array, "observation flights"],
        allowed: Bool[Array, "actions flights"],
        burst: Bool[Array, " flights"],
    ) -> Answer:
        """Query the policy for some flights.

        A flight is instructed if the policy would instruct it with a probability above
        1 - `PATIENCE`, or above one half if that continues a transmission; with the instruction
        that is then the most probable one.
        """
        logits = jnp.where(allowed, self._logits(weights, observation), -jnp.inf)
        chances = jax.nn.softmax(logits, axis=0)
        action = jnp.argmax(chances[NO_OP + 1 :], axis=0).astype(jnp.int32) + NO_OP + 1
        waits = chances[NO_OP]
        wanted = jnp.any(allowed[NO_OP + 1 :], axis=0) & (waits < jnp.where(burst, 0.5, PATIENCE))
        return Answer(action, wanted, waits)

    def _stack_one(
        self, weights: Weights, query: Query, slot: Int[Array, ""]
    ) -> tuple[ControlState, Int[Array, ""]]:
        """Serve one flight: instruct it until the policy gives no further instruction.

        If the burst returns to an earlier clearance (climb, descend, climb, ...), the flight keeps
        the repeated clearance with the largest margin.

        Returns the state and the number of instructions. In the state, only the outlook of this
        flight is up to date.
        """
        first = Answer(*(values[slot][None] for values in query.answer))
        visited = _Visited.begin(_cleared_to(query.state, slot), query.margin_s[slot])
        burst = _FlightBurst(query.state, first, jnp.int32(0), visited)

        def wants(burst: _FlightBurst) -> Bool[Array, ""]:
            kept = burst.visited.is_kept(_cleared_to(burst.state, slot))
            return burst.answer.wanted[0] & (burst.number < MOST_INSTRUCTIONS) & ~kept

        def instruct(burst: _FlightBurst) -> _FlightBurst:
            state = self.task.instruct_one(burst.state, slot, burst.answer.action[0])
            answer, count = self._ask_one(weights, state, slot), burst.number + 1
            margin_s = _margin_s(state.outlook.time_s[CLEARED, slot], answer.waits[0])
            visited = burst.visited.add(count, _cleared_to(state, slot), margin_s)
            return _FlightBurst(state, answer, count, visited)

        burst = jax.lax.while_loop(wants, instruct, burst)
        return burst.state, burst.number

    def _logits(
        self, weights: Weights, observation: Float[Array, "observation flights"]
    ) -> Float[Array, "actions flights"]:
        normaliser, actor = weights
        return forward(actor, normalise(normaliser, observation, columns=True), columns=True)


def _margin_s(time_s: Float[Array, "*flights"], waits: Float[Array, "*flights"]) -> Array:
    """Seconds until separation would be lost as cleared, plus the probability that the policy gives
    no instruction, which breaks ties."""
    return time_s + waits


def _cleared_to(state: ControlState, slot: Int[Array, ""]) -> Float[Array, " parts"]:
    """What a flight is cleared to, as numbers that can be compared."""
    traffic = state.world.traffic
    fix = (
        jnp.zeros_like(traffic.pending_turn) if traffic.cleared_fix is None else traffic.cleared_fix
    )
    parts = (
        traffic.cleared_level_ticks,
        traffic.cleared_heading_deg,
        traffic.pending_turn,
        fix,
        traffic.own_navigation,
    )
    return jnp.stack([values[slot].astype(jnp.float32) for values in parts])
