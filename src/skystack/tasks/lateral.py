"""Lateral navigation: steer aircraft through the sector with heading instructions.

The paper's task (sections "State", "Action", "Reward") with its variants as settings.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.simulator.generator import LateralScenarios
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic
from skystack.tasks import features, rewards
from skystack.tasks.actions import TurnTable
from skystack.tasks.contract import Metrics, Outcome
from skystack.tasks.settings import TaskSettings
from skystack.tasks.tracking import Memory, Tracker


class LateralState(NamedTuple):
    """What any simulator reports, and what the task remembers."""

    traffic: Traffic
    memory: Memory


@dataclass(frozen=True)
class LateralTask:
    """Implements `skystack.tasks.contract.Task`; `skystack.tasks.build` makes one from settings."""

    settings: TaskSettings
    simulator: Simulator
    scenarios: LateralScenarios
    actions: TurnTable

    version = 1

    @property
    def name(self) -> str:
        return self.settings.name

    @property
    def action_names(self) -> tuple[str, ...]:
        return self.actions.names

    @property
    def observation_names(self) -> tuple[str, ...]:
        return tuple(
            f"{name}_{aircraft + 1}"
            for aircraft in range(self.scenarios.aircraft)
            for name in self.settings.features
        )

    @cached_property
    def tracker(self) -> Tracker:
        return Tracker(self.simulator.sector)

    def reset(self, key: PRNGKeyArray) -> LateralState:
        return self.begin(self.scenarios.draw(key))

    def begin(self, traffic: Traffic) -> LateralState:
        """A scenario from given traffic; everybody is to leave at the level they start at."""
        return LateralState(traffic, self.tracker.begin(traffic, exit_level=traffic.level))

    def observe(self, state: LateralState) -> Float[Array, " observation"]:
        return features.observe(
            self.settings.features, self.simulator.sector, state.traffic, state.memory
        )

    def may_stack(self, state: LateralState, action: Int[Array, ""]) -> Bool[Array, ""]:
        return self.actions.may_stack(state.traffic, action)

    def instruct(self, state: LateralState, action: Int[Array, ""]) -> LateralState:
        heard = self.actions.addressed(action) & state.traffic.active
        return LateralState(
            self.actions.instruct(state.traffic, action),
            self.tracker.note_instruction(state.memory, heard, action),
        )

    def advance(self, state: LateralState) -> tuple[LateralState, Outcome]:
        return self.judge(state.memory, self.simulator.advance(state.traffic))

    def judge(self, memory: Memory, flown: Traffic) -> tuple[LateralState, Outcome]:
        """Everything of `advance` but flying, which another simulator may do."""
        before, memory = memory, self.tracker.track(memory, flown)
        traffic = flown._replace(active=flown.active & ~memory.exited)
        ended = ~jnp.any(traffic.active) | (memory.cycles >= self.settings.cycles)
        memory = memory._replace(strayed=memory.strayed | (ended & ~memory.entered))
        criteria = jnp.stack(self._criteria(memory))
        reward = self._running_reward(before, memory, flown) + jnp.where(
            ended, self.settings.reward.terminal * rewards.terminal(criteria), 0.0
        )
        outcome = Outcome(
            reward=reward,
            terminated=ended,
            truncated=jnp.zeros_like(ended),
            metrics=self._metrics(memory, jnp.all(criteria)),
        )
        return LateralState(traffic, memory), outcome

    def step(self, state: LateralState, action: Int[Array, ""]) -> tuple[LateralState, Outcome]:
        return self.advance(self.instruct(state, action))

    def _running_reward(self, before: Memory, memory: Memory, flown: Traffic) -> Float[Array, ""]:
        """Weighted sum of the terms of one cycle, averaged over all aircraft of the scenario."""
        weights, sector = self.settings.reward, self.simulator.sector
        distance = features.centreline_distance(sector, flown, memory)
        each = jnp.zeros_like(distance)
        if weights.centreline:
            each += weights.centreline * rewards.centreline(distance)
        if weights.damping:
            each += weights.damping * rewards.damping(memory.cycles_since_instruction)
        if weights.outside_band:
            each -= weights.outside_band * rewards.outside_band(distance, weights.band_nm)
        if weights.stray:
            each -= jnp.where(memory.strayed & ~before.strayed, weights.stray, 0.0)
        shared = -weights.burst * before.new_bursts
        return jnp.mean(jnp.where(flown.active, each, 0.0)) + shared

    def _criteria(self, memory: Memory) -> list[Bool[Array, " aircraft"]]:
        few = memory.instructions < rewards.MAX_INSTRUCTIONS
        criteria = [memory.exited_correctly, ~memory.strayed]
        return [*criteria, few] if self.settings.reward.count_criterion else criteria

    def _metrics(self, memory: Memory, success: Bool[Array, ""]) -> Metrics:
        return Metrics(
            success=success,
            correct_exit=jnp.all(memory.exited_correctly),
            excursion=jnp.any(memory.strayed),
            few_instructions=jnp.all(memory.instructions < rewards.MAX_INSTRUCTIONS),
            instructions=jnp.sum(memory.instructions),
            bursts=memory.bursts,
            min_separation_nm=memory.min_separation_nm,
            cycles=memory.cycles,
        )
