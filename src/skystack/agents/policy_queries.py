"""Queries of a policy about the flights of a sector: pure functions, which can be compiled.

Time is frozen. `begin` queries the policy for every flight, `stack` gives one flight its
instructions, and `again` queries the policy for every flight again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.agents.transmission import MOST_INSTRUCTIONS
from skystack.learning.inference import forward, normalise
from skystack.stacking import NO_OP
from skystack.tasks.outlook import CLEARED
from skystack.tasks.sector_control import ControlState, SectorControl
from skystack.tasks.sector_world import WorldState

PATIENCE = 0.7
"""A flight is instructed only if the probability that the policy waits is below this. In training,
actions are sampled, so it hardly matters in which of several cycles an instruction is given, or
which of several good ones it is. So "none" may be the most probable action in every cycle.
"""


Weights = Any
"""What a policy's logits depend on besides the observation."""
Logits = Callable[[Weights, Float[Array, "observation flights"]], Float[Array, "actions flights"]]
"""(weights, observation) -> unnormalised log-probabilities of the actions."""


def network_logits(
    weights: Weights, observation: Float[Array, "observation flights"]
) -> Float[Array, "actions flights"]:
    """The logits of a network. The weights are (normaliser, actor)."""
    normaliser, actor = weights
    return forward(actor, normalise(normaliser, observation, columns=True), columns=True)


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
    def begin(
        cls, clearance: Float[Array, " parts"], margin_s: Float[Array, ""], instructions: int
    ) -> "_Visited":
        """A record of only the clearance before a burst of at most `instructions` instructions."""
        most = instructions + 1
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


@dataclass(frozen=True)
class Queries:
    """Queries a policy of a task. Equal ones share their compiled programs."""

    task: SectorControl
    logits: Logits = network_logits
    most_instructions: int = MOST_INSTRUCTIONS
    """The maximum number of instructions in a burst."""

    def begin(self, weights: Weights, world: WorldState, since: Float[Array, " slots"]) -> Query:
        """The query before anything is said in a cycle.

        `since` has the number of cycles since the last transmission to each flight.
        """
        return self.ask(weights, self._begun(world, since))

    def ask(self, weights: Weights, state: ControlState) -> Query:
        """The query in a state whose outlook is up to date."""
        answer = self._answer(weights, *self._columns(state))
        return Query(state, answer, _margin_s(state.outlook.time_s[CLEARED], answer.waits))

    def again(self, weights: Weights, state: ControlState) -> Query:
        """The query after a transmission: the outlook is computed again."""
        return self.ask(weights, self.task.with_outlook(state))

    def certainty(
        self,
        weights: Weights,
        world: WorldState,
        since: Float[Array, " slots"],
        slot: Int[Array, ""],
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The probability of an instruction to a flight before anything is said, and the entropy.

        The entropy is that of the choice among the allowed actions, from 0 (certain) to 1 (all
        equally likely).
        """
        state = self._begun(world, since)
        allowed = self.task.allowed(state)[:, slot]
        logits = self.logits(weights, self.task.observe(state)[:, slot][:, None])[:, 0]
        chances = jax.nn.softmax(jnp.where(allowed, logits, -jnp.inf))
        most = jnp.log(jnp.maximum(jnp.sum(allowed.astype(jnp.float32)), 2.0))
        entropy = -jnp.sum(jax.scipy.special.xlogy(chances, chances)) / most
        return 1.0 - chances[NO_OP], entropy

    def stack(
        self, weights: Weights, query: Query, slot: Int[Array, ""]
    ) -> tuple[ControlState, Int[Array, ""]]:
        """Serve one flight: instruct it until the policy gives no further instruction.

        If the burst returns to an earlier clearance (climb, descend, climb, ...), the flight keeps
        the repeated clearance with the largest margin.

        Returns the state and the number of instructions. In the state, only the outlook of this
        flight is up to date.
        """
        first = Answer(*(values[slot][None] for values in query.answer))
        visited = _Visited.begin(
            _cleared_to(query.state, slot), query.margin_s[slot], self.most_instructions
        )
        burst = _FlightBurst(query.state, first, jnp.int32(0), visited)

        def wants(burst: _FlightBurst) -> Bool[Array, ""]:
            kept = burst.visited.is_kept(_cleared_to(burst.state, slot))
            return burst.answer.wanted[0] & (burst.number < self.most_instructions) & ~kept

        def instruct(burst: _FlightBurst) -> _FlightBurst:
            state = self.task.instruct_one(burst.state, slot, burst.answer.action[0])
            answer, count = self._ask_one(weights, state, slot), burst.number + 1
            margin_s = _margin_s(state.outlook.time_s[CLEARED, slot], answer.waits[0])
            visited = burst.visited.add(count, _cleared_to(state, slot), margin_s)
            return _FlightBurst(state, answer, count, visited)

        burst = jax.lax.while_loop(wants, instruct, burst)
        return burst.state, burst.number

    def _begun(self, world: WorldState, since: Float[Array, " slots"]) -> ControlState:
        return self.task.begin(world)._replace(since_cycles=since)

    def _ask_one(self, weights: Weights, state: ControlState, slot: Int[Array, ""]) -> Answer:
        """Query the policy for one flight."""
        columns = self._columns(state)
        return self._answer(weights, *(values[..., slot][..., None] for values in columns))

    def _columns(self, state: ControlState) -> tuple[Array, Array, Array]:
        """What an answer depends on, one column per flight: see `_answer`."""
        return self.task.observe(state), self.task.allowed(state), state.burst

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
        logits = jnp.where(allowed, self.logits(weights, observation), -jnp.inf)
        chances = jax.nn.softmax(logits, axis=0)
        action = jnp.argmax(chances[NO_OP + 1 :], axis=0).astype(jnp.int32) + NO_OP + 1
        waits = chances[NO_OP]
        wanted = jnp.any(allowed[NO_OP + 1 :], axis=0) & (waits < jnp.where(burst, 0.5, PATIENCE))
        return Answer(action, wanted, waits)


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
