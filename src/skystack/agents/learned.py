"""A learned controller of a sector: one policy for all flights, its instructions stacked.

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
from jaxtyping import Bool

from skystack.agents.policy_queries import Queries, Query, Weights
from skystack.agents.safety_net import alerts, lasts_s, way_out
from skystack.agents.since import SinceTransmission
from skystack.agents.transmission import (
    PER_CYCLE,
    Transmission,
    clearance_of,
    transmission_between,
)
from skystack.compilation.shared import shared_program
from skystack.learning.policy import Policy
from skystack.tasks.outlook import CLEARED
from skystack.tasks.sector_control import ControlState, SectorControl
from skystack.tasks.sector_world import WorldState


def weights_of(policy: Policy) -> Weights:
    """The weights of a policy, as `skystack.agents.policy_queries.network_logits` takes them.

    They are arguments of the compiled programs, so policies of the same shape share the programs.
    """
    return jax.tree.map(jnp.asarray, (policy.normaliser, policy.actor))


class Certainty(NamedTuple):
    """How certain a policy is about a flight."""

    probability: float
    """That it gives an instruction now."""
    entropy: float
    """Of its choice among the allowed actions, from 0 (certain) to 1 (all equally likely)."""


class Learned:
    """Implements `skystack.agents.transmission.SectorAgent`.

    `per_cycle` is the maximum number of transmissions in a cycle. `safety_net` turns on the safety
    net (`skystack.agents.safety_net`).
    """

    def __init__(
        self,
        queries: Queries,
        weights: Weights,
        per_cycle: int = PER_CYCLE,
        safety_net: bool = True,
    ) -> None:
        self.per_cycle, self.safety_net = per_cycle, safety_net
        self._queries, self._weights = queries, weights

    @property
    def task(self) -> SectorControl:
        return self._queries.task

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
                query = self._again(self._weights, told)
        self._since.end_cycle(sent)
        return sent

    def certainty(self, state: WorldState, slot: int) -> Certainty:
        """How certain the policy is about the flight in a slot, before anything is transmitted."""
        since = self._since.cycles(state)
        probability, entropy = self._certainty(self._weights, state, since, slot)
        return Certainty(float(probability), float(entropy))

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
            rescued = self._instruct(told.world, clearance_of([way], self.task.agents))
            return told._replace(world=rescued), instructions + 1
        before_s = lasts_s(query.state.outlook)[CLEARED, slot]
        return (query.state, 0) if time_s[CLEARED] < before_s else (told, instructions)

    @cached_property
    def _begin(self) -> Any:
        return shared_program(self._queries.begin)

    @cached_property
    def _stack(self) -> Any:
        return shared_program(self._queries.stack)

    @cached_property
    def _again(self) -> Any:
        return shared_program(self._queries.again)

    @cached_property
    def _certainty(self) -> Any:
        return shared_program(self._queries.certainty)

    @cached_property
    def _instruct(self) -> Any:
        return shared_program(self.task.world.instruct)
