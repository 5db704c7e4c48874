"""Navigation: bring aircraft through the sector to their exits with small instructions.

The paper's tasks (sections "State", "Action", "Reward"), lateral, vertical and avoidance, are this
one under different settings: which scenarios, what is seen and said, and what is paid for.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.generator import Scenarios
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic
from skystack.tasks import features, rewards
from skystack.tasks.actions import ActionTable, addressed
from skystack.tasks.contract import Metrics, Outcome
from skystack.tasks.pairs import RANGE_NM, observe_pairs, pair_names, pairs_of
from skystack.tasks.settings import TaskSettings
from skystack.tasks.tracking import Memory, Tracker


class NavigationState(NamedTuple):
    """What any simulator reports, and what the task remembers."""

    traffic: Traffic
    memory: Memory


@dataclass(frozen=True)
class NavigationTask:
    """Implements `skystack.tasks.contract.Task`; `skystack.tasks.build` makes one from settings."""

    settings: TaskSettings
    simulator: Simulator
    scenarios: Scenarios
    actions: ActionTable

    version = 1

    @property
    def name(self) -> str:
        return self.settings.name

    @property
    def action_names(self) -> tuple[str, ...]:
        return self.actions.names

    @property
    def observation_names(self) -> tuple[str, ...]:
        count, settings = self.scenarios.aircraft, self.settings
        each = (f"{name}_{aircraft + 1}" for aircraft in range(count) for name in settings.features)
        return (*each, *pair_names(settings.pair_features, count))

    @property
    def sector(self) -> Sector:
        return self.simulator.sector

    @cached_property
    def tracker(self) -> Tracker:
        return Tracker(self.sector)

    def traffic(self, state: NavigationState) -> Traffic:
        """All that can be seen on a radar."""
        return state.traffic

    def reset(self, key: PRNGKeyArray) -> NavigationState:
        return self.begin(*self.scenarios.draw(key))

    def begin(
        self, traffic: Traffic, exit_level_ticks: Float[Array, "aircraft *batch"] | None = None
    ) -> NavigationState:
        """A scenario from given traffic; who has no exit level is to leave as it starts."""
        level_ticks = traffic.level_ticks if exit_level_ticks is None else exit_level_ticks
        return NavigationState(traffic, self.tracker.begin(traffic, level_ticks))

    def observe(self, state: NavigationState) -> Float[Array, "observation *batch"]:
        seen = features.observe(
            self.settings.features, self.simulator.sector, state.traffic, state.memory
        )
        if not self.settings.pair_features:
            return seen
        plane, names = self.sector.plane, self.settings.pair_features
        return jnp.concatenate([seen, observe_pairs(names, plane, state.traffic)])

    def may_stack(
        self, state: NavigationState, action: Int[Array, "*batch"]
    ) -> Bool[Array, "*batch"]:
        return self.actions.may_stack(state.traffic, action)

    def instruct(self, state: NavigationState, action: Int[Array, "*batch"]) -> NavigationState:
        heard = addressed(self.actions, state.traffic, action) & state.traffic.active
        return NavigationState(
            self.actions.instruct(state.traffic, action),
            self.tracker.note_instruction(state.memory, heard, action),
        )

    def advance(self, state: NavigationState) -> tuple[NavigationState, Outcome]:
        return self.judge(state.memory, subroutine(self.simulator.advance, state.traffic))

    def judge(self, memory: Memory, flown: Traffic) -> tuple[NavigationState, Outcome]:
        """Everything of `advance` but flying, which another simulator may do."""
        before, memory = memory, subroutine(self.tracker.track, memory, flown)
        traffic = flown._replace(active=flown.active & ~memory.exited)
        ended = ~jnp.any(traffic.active, axis=0) | (memory.cycles >= self.settings.cycles)
        memory = memory._replace(excursion=memory.excursion | (ended[None] & ~memory.entered))
        criteria = jnp.stack(self._criteria(memory))
        reward = self._running_reward(before, memory, flown) + jnp.where(
            ended, self.settings.reward.terminal * rewards.terminal(criteria), 0.0
        )
        outcome = Outcome(
            reward=reward,
            terminated=ended,
            truncated=jnp.zeros_like(ended),
            metrics=self._metrics(memory, jnp.all(criteria, axis=(0, 1))),
        )
        return NavigationState(traffic, memory), outcome

    def step(
        self, state: NavigationState, action: Int[Array, "*batch"]
    ) -> tuple[NavigationState, Outcome]:
        return self.advance(self.instruct(state, action))

    def _running_reward(
        self, before: Memory, memory: Memory, flown: Traffic
    ) -> Float[Array, "*batch"]:
        """Weighted sum of the terms of one cycle, averaged over all aircraft of the scenario."""
        weights, sector = self.settings.reward, self.simulator.sector
        distance = features.centreline_distance(sector, flown, memory)
        each = jnp.zeros_like(flown.level_ticks)
        if weights.centreline:
            each += weights.centreline * rewards.centreline(distance)
        if weights.damping:
            each += weights.damping * rewards.damping(memory.cycles_since_instruction)
        if weights.outside_band:
            each -= weights.outside_band * rewards.outside_band(distance, weights.band_nm)
        if weights.stray:
            each -= jnp.where(memory.excursion & ~before.excursion, weights.stray, 0.0)
        if weights.vertical:
            gap_fl = (flown.cleared_level_ticks - memory.exit_level_ticks) / TICKS_PER_FL
            each += weights.vertical * rewards.vertical(gap_fl)
        shared = -weights.burst * before.new_bursts
        if weights.safety:
            shared += weights.safety * self._safety(flown)
        if weights.conflict:
            inside_nm = weights.conflict_nm - memory.separation_nm
            shared -= weights.conflict * jnp.maximum(inside_nm, 0.0)
        return jnp.mean(jnp.where(flown.active, each, 0.0), axis=0) + shared

    def _safety(self, flown: Traffic) -> Float[Array, "*batch"]:
        """The safety reward of the scenario: its worst pair's."""
        pairs = pairs_of(self.sector.plane, flown)
        each = rewards.safety(pairs.distance_nm, pairs.closest_nm, RANGE_NM)
        return jnp.min(jnp.where(pairs.active, each, 0.0), axis=0, initial=0.0)

    def _criteria(self, memory: Memory) -> list[Bool[Array, "aircraft *batch"]]:
        few = memory.instructions < rewards.MAX_INSTRUCTIONS
        criteria = [memory.exited_correctly, ~memory.excursion]
        return [*criteria, few] if self.settings.reward.count_criterion else criteria

    def _metrics(self, memory: Memory, success: Bool[Array, "*batch"]) -> Metrics:
        return Metrics(
            success=success,
            correct_exit=jnp.all(memory.exited_correctly, axis=0),
            excursion=jnp.any(memory.excursion, axis=0),
            few_instructions=jnp.all(memory.instructions < rewards.MAX_INSTRUCTIONS, axis=0),
            instructions=jnp.sum(memory.instructions, axis=0),
            bursts=memory.bursts,
            min_separation_nm=memory.min_separation_nm,
            cycles=memory.cycles,
        )
