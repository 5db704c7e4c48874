"""A policy of one of the paper's tasks as a controller of a sector, in scenarios without arrivals.

Its bursts are stacked, as in an evaluation of the task: at most one clearance in each cycle.
"""

from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from skystack.agents.transmission import Transmission, transmission_between
from skystack.airspace.sector import Sector
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.errors import InputError
from skystack.learning.choices import Weights, most_probable
from skystack.learning.policy import Policy
from skystack.simulator.traffic import Traffic
from skystack.stacking import Stack, stack_traced
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.progress import Progress
from skystack.tasks.sector_world import WorldState


class ScenarioAgent:
    """Implements `skystack.agents.transmission.SectorAgent` with the most probable actions.

    The flights of the task are those in the first slots.
    """

    def __init__(self, policy: Policy, task: NavigationTask) -> None:
        self._task = task
        self._weights: Weights = (policy.actor, policy.normaliser)
        self._last: tuple[int, NavigationState] | None = None
        """The number of cycles flown at the last decision, and the state after it."""

    def begin(self, state: WorldState) -> None:
        """Forget the last decision. The state may be in the middle of a scenario."""
        self._last = None

    def transmit(self, state: WorldState) -> list[Transmission]:
        cycle = int(state.arrivals.cycle)
        if self._last is not None and self._last[0] == cycle - 1:
            decided = self._next_decision(self._weights, self._last[1], self._traffic(state))
        else:
            decided = self._first_decision(self._weights, *self._task_inputs(state))
        instructed, stack = fetched(decided)
        self._last = cycle, instructed
        aircraft = self._task.actions[int(stack.action)].aircraft
        if aircraft is None or stack.instructions == 0:
            return []
        sent = transmission_between(
            state.traffic, instructed.traffic, aircraft, int(stack.instructions)
        )
        return [] if sent is None else [sent]

    def _traffic(self, state: WorldState) -> Traffic:
        traffic: Traffic = jax.tree.map(lambda values: values[: self._task.aircraft], state.traffic)
        return traffic

    def _task_inputs(self, state: WorldState) -> tuple[Traffic, Any, Progress]:
        """The traffic, the exit levels and the progress of the task's flights."""
        count = self._task.aircraft
        progress: Progress = jax.tree.map(
            lambda values: values[:count] if np.ndim(values) else values, state.progress
        )
        return self._traffic(state), state.arrivals.exit_level_ticks[:count], progress

    @cached_property
    def _first_decision(self) -> Any:
        return shared_program(_first_decision, self._task)

    @cached_property
    def _next_decision(self) -> Any:
        return shared_program(_next_decision, self._task)


def _first_decision(
    task: NavigationTask,
    weights: Any,
    traffic: Traffic,
    exit_level_ticks: Array,
    progress: Progress,
) -> tuple[NavigationState, Stack]:
    begun = task.begin(traffic, exit_level_ticks)
    return _decision(task, weights, begun._replace(memory=begun.memory._replace(progress=progress)))


def _next_decision(
    task: NavigationTask, weights: Any, state: NavigationState, flown: Traffic
) -> tuple[NavigationState, Stack]:
    """The decision after a cycle. `state` is the state after the previous decision."""
    ended, _ = task.end_cycle(state, flown)
    return _decision(task, weights, ended._replace(traffic=flown))


def _decision(
    task: NavigationTask, weights: Any, state: NavigationState
) -> tuple[NavigationState, Stack]:
    return stack_traced(task, partial(most_probable, weights), state, jax.random.key(0))


def check_fits_scenario(task: NavigationTask, sector: Sector, flights: int) -> None:
    """Raise InputError unless a task has the number of flights, routes and fixes of a scenario."""
    if task.aircraft != flights:
        raise InputError(
            f"a policy for {task.aircraft} aircraft in a scenario of {flights} (allowed: a policy "
            f"for {flights})"
        )
    if (task.sector.routes, task.sector.fixes) != (sector.routes, sector.fixes):
        raise InputError(
            f"a policy for sector {task.sector.name} in a scenario of {sector.name} (allowed: a "
            f"policy for {sector.name})"
        )
