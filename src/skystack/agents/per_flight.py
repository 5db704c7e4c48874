"""Controllers that choose actions for single flights, from the task's table.

The actions for a flight in one cycle, taken one after another with time frozen, become one
transmission. Policies of other libraries take one action for each flight in each cycle, as in the
environments of `skystack.gym`.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.agents.agent import Agent
from skystack.agents.callsigns import Callsigns
from skystack.agents.queries import QueryNames, query_actions
from skystack.agents.since import SinceTransmission
from skystack.agents.transmission import Transmission, transmission_between
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.tasks.outlook import no_outlook
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_world import WorldState


class FlightViews(NamedTuple):
    """What is observed of the flight in each slot."""

    observation: Float[np.ndarray, "slots observation"]
    allowed: Bool[np.ndarray, "slots actions"]
    """Which actions change something. Action 0, none, is always allowed."""


class FlightActions:
    """Observes flights for a task, and compiles their actions into transmissions."""

    def __init__(self, task: SectorControl) -> None:
        self.task = task
        self.begin()

    def begin(self) -> None:
        """Forget everything: a new scenario begins."""
        self._since = SinceTransmission(self.task.agents)

    def observe(self, state: WorldState) -> FlightViews:
        """What is observed of all flights, before any transmission in a cycle."""
        return FlightViews(*map(np.asarray, self._observe(state, self._since.cycles(state))))

    def transmissions(
        self, state: WorldState, actions: Mapping[int, Sequence[int]]
    ) -> list[Transmission]:
        """The transmissions that give flights, by slot, their instructions one after another.

        Actions that change nothing are ignored. Call it once in each cycle.
        """
        self._since.cycles(state)
        told, slots = state, self.task.agents
        counts = np.zeros(slots, dtype=np.int64)
        for number in range(max(map(len, actions.values()), default=0)):
            row = np.zeros(slots, dtype=np.int32)
            for slot, chosen in actions.items():
                row[slot] = chosen[number] if number < len(chosen) else 0
            told, changed = fetched(self._instruct(told, row))
            counts += changed
        between = (
            transmission_between(state.traffic, told.traffic, slot, int(counts[slot]))
            for slot in actions
        )
        sent = [each for each in between if each is not None]
        self._since.end_cycle(sent)
        return sent

    @cached_property
    def _observe(self) -> Any:
        return shared_program(_observed, self.task)

    @cached_property
    def _instruct(self) -> Any:
        return shared_program(_instructed, self.task)


def _observed(
    task: SectorControl, world: WorldState, since: Float[Array, " slots"]
) -> tuple[Array, Array]:
    """The observations and allowed actions, one row per slot."""
    state = task.begin(world)._replace(since_cycles=since)
    return task.observe(state).T, task.allowed(state).T


def _instructed(
    task: SectorControl, world: WorldState, action: Int[Array, " slots"]
) -> tuple[WorldState, Bool[Array, " slots"]]:
    """The world after the actions, and who was instructed."""
    state = task.begin(world, no_outlook((task.agents,)))
    return task.told(state, action).world, task.may_stack(state, action)


class PerFlight:
    """Flies an agent of another library, which chooses one action for a flight from what is
    observed of it. Implements `skystack.agents.transmission.SectorAgent`.

    If there are more instructions than `per_cycle`, the flights with the least time to a loss of
    separation get theirs first.
    """

    def __init__(self, agent: Agent, task: SectorControl, per_cycle: int) -> None:
        self.agent, self.per_cycle = agent, per_cycle
        self._flights = FlightActions(task)
        self._time_to_loss = task.observation_names.index("time to loss, cleared")

    def begin(self, state: WorldState) -> None:
        self._flights.begin()
        self._names = Callsigns(self._flights.task.flow.callsigns)

    def transmit(self, state: WorldState) -> list[Transmission]:
        """Raises InputError if the agent fails or answers anything but an action of the table."""
        self._names.follow(state)
        slots = np.flatnonzero(state.hears)
        if not len(slots):
            return []
        views = self._flights.observe(state)
        rows = views.observation[slots]
        flights = np.asarray(state.arrivals.flight)[slots].tolist()
        asked = QueryNames(flights, int(state.arrivals.cycle), self._names.__getitem__)
        chosen = query_actions(self.agent, rows, asked, views.allowed.shape[1])
        changes = views.allowed[slots, chosen] & (chosen != 0)
        urgent = np.argsort(rows[:, self._time_to_loss], kind="stable")
        served = [index for index in urgent.tolist() if changes[index]][: self.per_cycle]
        return self._flights.transmissions(
            state, {int(slots[index]): [int(chosen[index])] for index in served}
        )
