"""Navigation: guide aircraft through the sector to their exits with small instructions.

The paper's tasks (sections "State", "Action" and "Reward") are this task with different settings
for scenarios, observation, actions and rewards.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.fleet import AircraftType
from skystack.simulator.generator import Scenarios
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic
from skystack.tasks import features, metrics, rewards
from skystack.tasks.actions import ActionTable
from skystack.tasks.contract import Action, AircraftStatus, Metric, Outcome
from skystack.tasks.instruction_counts import end_burst
from skystack.tasks.pairs import observe_pairs, pair_names
from skystack.tasks.settings import NavigationSettings
from skystack.tasks.tracking import Memory, Tracker


class NavigationState(NamedTuple):
    """The traffic, as any platform reports it, and the memory of the task."""

    traffic: Traffic
    memory: Memory


@dataclass(frozen=True)
class NavigationTask:
    """Implements `skystack.tasks.contract.TrafficTask`, with one agent for all aircraft."""

    settings: NavigationSettings
    simulator: Simulator
    scenarios: Scenarios
    table: ActionTable

    version = 1
    agents = 1

    @property
    def name(self) -> str:
        return self.settings.name

    @property
    def action_names(self) -> tuple[str, ...]:
        return self.table.names

    @property
    def observation_names(self) -> tuple[str, ...]:
        settings = self.settings
        each = (
            f"{name}_{aircraft + 1}"
            for aircraft in range(self.aircraft)
            for name in settings.features
        )
        return (*each, *pair_names(settings.pair_features, self.aircraft))

    @property
    def metrics(self) -> Mapping[str, Metric]:
        return metrics.SPECIFICATIONS

    @property
    def sector(self) -> Sector:
        return self.simulator.sector

    @property
    def performance(self) -> str:
        return self.settings.performance

    @property
    def fleet(self) -> tuple[AircraftType, ...]:
        return self.settings.fleet

    @property
    def aircraft(self) -> int:
        return self.scenarios.aircraft

    @property
    def cycles(self) -> int:
        return self.settings.cycles

    @property
    def actions(self) -> tuple[Action, ...]:
        return self.table.actions

    @cached_property
    def tracker(self) -> Tracker:
        return Tracker(self.sector, self.settings.airway_nm)

    def traffic(self, state: NavigationState) -> Traffic:
        return state.traffic

    def status(self, state: NavigationState) -> AircraftStatus:
        progress = state.memory.progress
        return AircraftStatus(progress.entered, progress.exited, progress.excursion)

    def exit_level_ticks(self, state: NavigationState) -> Float[Array, "aircraft *batch"]:
        return state.memory.plan.exit_level_ticks

    def with_traffic(self, state: NavigationState, traffic: Traffic) -> NavigationState:
        return state._replace(traffic=traffic)

    def reset(self, key: PRNGKeyArray) -> NavigationState:
        return self.begin(*self.scenarios.draw(key))

    def begin(
        self,
        traffic: Traffic,
        exit_level_ticks: Float[Array, "aircraft *batch"] | None = None,
    ) -> NavigationState:
        """The initial state of a scenario with the given traffic.

        Exit levels default to the initial levels.
        """
        levels = traffic.level_ticks if exit_level_ticks is None else exit_level_ticks
        return NavigationState(traffic, self.tracker.begin(traffic, levels))

    def observe(self, state: NavigationState) -> Float[Array, "observation *batch"]:
        names, pair_feature_names = self.settings.features, self.settings.pair_features
        observation = features.observe(names, self.sector, state.traffic, state.memory)
        if not pair_feature_names:
            return observation
        pairs = observe_pairs(pair_feature_names, self.sector.plane, state.traffic)
        return jnp.concatenate([observation, pairs])

    def may_stack(
        self, state: NavigationState, action: Int[Array, "*batch"]
    ) -> Bool[Array, "*batch"]:
        return self.table.may_stack(self._reachable(state), action)

    def instruct(self, state: NavigationState, action: Int[Array, "*batch"]) -> NavigationState:
        reachable = self._reachable(state)
        instructed = self.table.addressed(reachable, action) & reachable.active
        return NavigationState(
            self.table.instruct(reachable, action)._replace(active=state.traffic.active),
            self.tracker.instruct(state.memory, instructed, action),
        )

    def _reachable(self, state: NavigationState) -> Traffic:
        """The traffic, in which only the aircraft that can be instructed are active."""
        if self.settings.control == "always":
            return state.traffic
        active = state.traffic.active & state.memory.progress.entered
        return state.traffic._replace(active=active)

    def end_burst(self, state: NavigationState) -> NavigationState:
        """End the burst, so that the next instruction starts a new one."""
        return state._replace(memory=state.memory._replace(counts=end_burst(state.memory.counts)))

    def advance(self, state: NavigationState) -> tuple[NavigationState, Outcome]:
        return self.end_cycle(state, subroutine(self.simulator.advance, state.traffic))

    def end_cycle(self, state: NavigationState, flown: Traffic) -> tuple[NavigationState, Outcome]:
        before, memory = state.memory, subroutine(self.tracker.track, state.memory, flown)
        traffic = flown._replace(active=flown.active & ~memory.progress.exited)
        at_time_limit = memory.progress.cycles >= self.settings.cycles
        ended = at_time_limit
        if self.settings.ends_early:
            ended |= ~jnp.any(traffic.active, axis=0)
        memory = self.tracker.close(memory, ended)
        cycle = rewards.Cycle(self.sector, self.settings.reward, before, memory, flown)
        success = jnp.all(cycle.criteria, axis=(0, 1))
        outcome = Outcome(
            reward=rewards.total(cycle, ended)[None],
            terminated=ended[None],
            truncated=jnp.zeros_like(ended)[None],
            ended=ended,
            metrics=metrics.measure(memory, success),
        )
        return NavigationState(traffic, memory), outcome

    def step(
        self, state: NavigationState, action: Int[Array, "*batch"]
    ) -> tuple[NavigationState, Outcome]:
        return self.advance(self.instruct(state, action))

    def succeeded(
        self,
        metrics: Mapping[str, np.ndarray],
        clearances: Int[np.ndarray, "scenarios aircraft"],
    ) -> Bool[np.ndarray, " scenarios"]:
        success = metrics["correct_exit"] & ~metrics["excursion"]
        if self.settings.reward.count_criterion:
            success = success & np.all(clearances < rewards.MAX_INSTRUCTIONS, axis=1)
        return success
