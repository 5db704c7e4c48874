"""The task `sector-control`: every flight of a sector is an agent, and all share one policy.

Each cycle, every flight that hears the controller takes one action: none, a turn of 10 degrees, a
climb or descent of 10 flight levels, or direct to the next fix of its route. Instructions to a
flight in consecutive cycles form one transmission, as instructions in one stack do. For training
with frozen time, see `skystack.tasks.sector_stacks`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.geometry import first_and_second, wrap_360
from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.arrival_flows import Flow
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import DIRECT, NO_TURN, SHORTEST, Clearance, ticks
from skystack.stacking import NO_OP
from skystack.tasks.contract import Metric, Outcome
from skystack.tasks.features import exit_distance
from skystack.tasks.outlook import CLEARED, Outlook
from skystack.tasks.sector_observation import (
    NAMES,
    SINCE_CYCLES,
    Seen,
    memory_of,
    observe_flights,
)
from skystack.tasks.sector_rewards import FlightCycle, SectorRewardSettings, total_reward
from skystack.tasks.sector_world import World, WorldCycle, WorldState
from skystack.tasks.separation import pair_distance_squared

NONE, LEFT_10, RIGHT_10, CLIMB, DESCEND, TO_FIX = range(6)
ACTIONS = ("none", "turn -10 deg", "turn +10 deg", "climb 10 FL", "descend 10 FL", "direct")
TURN_DEG, STEP_FL = 10.0, 10.0

METRICS = {
    "correct_exit": Metric("share", "flights that left through their exits at their exit levels"),
    "excursion": Metric("share", "flights that left elsewhere"),
    "losses": Metric("count per 1,000 flights", "flights that lost separation"),
    "transmissions": Metric("count per flight", "transmissions"),
    "flights": Metric("count", "flights that left"),
}


class Totals(NamedTuple):
    """Counts of a scenario so far, `[*batch]`."""

    left: Float[Array, "*batch"]
    correct: Float[Array, "*batch"]
    excursions: Float[Array, "*batch"]
    losses: Float[Array, "*batch"]
    transmissions: Float[Array, "*batch"]


class ControlState(NamedTuple):
    """The sector, and what the controller remembers of each flight."""

    world: WorldState
    outlook: Outlook
    burst: Bool[Array, "slots *batch"]
    """Whether a further instruction continues a transmission."""
    began: Bool[Array, "slots *batch"]
    """Whether a transmission began in this cycle."""
    instructions: Float[Array, "slots *batch"]
    """The number of instructions to the flight in this cycle."""
    since_cycles: Float[Array, "slots *batch"]
    level_gap_ticks: Float[Array, "slots *batch"]
    """The distance of the cleared level from the exit level at the end of the last cycle."""
    exit_nm: Float[Array, "slots *batch"]
    """The distance from the exit at the end of the last cycle."""
    lost: Bool[Array, "slots *batch"]
    """Whether the flight had no separation in the last cycle."""
    totals: Totals
    lasts: Int[Array, "*batch"]
    """The number of cycles after which the scenario ends."""

    @property
    def seen(self) -> Seen:
        """What can be observed."""
        return Seen(self.world, self.outlook, self.burst, self.since_cycles)


@dataclass(frozen=True)
class SectorControl:
    """Implements `skystack.tasks.contract.ManyAgents`."""

    flow: Flow
    cycles: int
    reward: SectorRewardSettings  # type: ignore[valid-type]

    name = "sector-control"
    version = 1
    action_names = ACTIONS
    observation_names = NAMES

    @property
    def metrics(self) -> Mapping[str, Metric]:
        return METRICS

    @property
    def agents(self) -> int:
        return self.flow.slots

    @property
    def sector(self) -> Sector:
        return self.flow.simulator.sector

    @property
    def simulator(self) -> Simulator:
        return self.flow.simulator

    @cached_property
    def world(self) -> World:
        return World(self.flow)

    def reset(self, key: PRNGKeyArray) -> ControlState:
        # Scenarios of different lengths, so that not all environments are empty at the same time.
        least = max(self.cycles // 3, 1)
        lasts = jax.random.randint(jax.random.fold_in(key, 1), (), least, self.cycles + 1)
        return self.begin(self.world.reset(key))._replace(lasts=lasts)

    def begin(self, world: WorldState, outlook: Outlook | None = None) -> ControlState:
        """The state in which nothing has been said yet. The outlook is computed if not given."""
        nobody = jnp.zeros_like(world.traffic.active)
        zero = jnp.zeros(world.traffic.active.shape[1:], dtype=jnp.float32)
        return ControlState(
            world=world,
            outlook=self.world.look_ahead(world) if outlook is None else outlook,
            burst=nobody,
            began=nobody,
            instructions=nobody.astype(jnp.float32),
            since_cycles=nobody.astype(jnp.float32) + SINCE_CYCLES,
            level_gap_ticks=_level_gap(world),
            exit_nm=self._exit_nm(world),
            lost=nobody,
            totals=Totals(zero, zero, zero, zero, zero),
            lasts=zero.astype(jnp.int32) + self.cycles,
        )

    def observe(self, state: ControlState) -> Float[Array, "observation slots *batch"]:
        return observe_flights(self.sector, state.seen)

    def active(self, state: ControlState) -> Bool[Array, "slots *batch"]:
        """The flights that hear the controller."""
        hears: Bool[Array, "slots *batch"] = state.world.hears
        return hears

    def waiting(self, state: ControlState) -> Bool[Array, "slots *batch"]:
        """Nobody: every flight that hears the controller decides in every cycle."""
        return jnp.zeros_like(state.burst)

    def may_stack(
        self, state: ControlState, action: Int[Array, "slots *batch"]
    ) -> Bool[Array, "slots *batch"]:
        """Whether each action is an instruction that changes a clearance."""
        traffic = state.world.traffic
        lowest, highest = (ticks(float(fl)) for fl in self.sector.levels_fl)
        step, cleared = ticks(STEP_FL), traffic.cleared_level_ticks
        allowed = (action == LEFT_10) | (action == RIGHT_10)
        allowed |= (action == CLIMB) & (cleared + step <= highest)
        allowed |= (action == DESCEND) & (cleared - step >= lowest)
        allowed |= (action == TO_FIX) & ~traffic.cleared_along_route
        return allowed & self.active(state)

    def allowed(self, state: ControlState) -> Bool[Array, "actions slots *batch"]:
        """Which actions change something; none always counts as allowed."""

        def may_take(number: Int[Array, ""]) -> Bool[Array, "slots *batch"]:
            return self.may_stack(state, jnp.full(state.burst.shape, number))

        changes: Bool[Array, "actions slots *batch"] = jax.vmap(may_take)(
            jnp.arange(len(ACTIONS), dtype=jnp.int32)
        )
        return changes.at[NO_OP].set(True)

    def end_burst(self, state: ControlState) -> ControlState:
        """The same state, in which an instruction begins a new transmission."""
        return state._replace(burst=jnp.zeros_like(state.burst))

    def instruct(self, state: ControlState, action: Int[Array, "slots *batch"]) -> ControlState:
        """Change clearances. Actions that `may_stack` excludes change nothing."""
        return self.with_outlook(self.told(state, action))

    def with_outlook(self, state: ControlState) -> ControlState:
        """The state, with the outlook computed again from its clearances."""
        return state._replace(outlook=self.world.look_ahead(state.world))

    def instruct_one(
        self, state: ControlState, slot: Int[Array, ""], action: Int[Array, ""]
    ) -> ControlState:
        """Instruct one flight. Only its own outlook is computed again."""
        here = jnp.arange(self.agents, dtype=jnp.int32) == slot
        state = self.told(state, jnp.where(here, action, NO_OP))
        own = self.world.look_ahead_for(state.world, slot)
        return state._replace(
            outlook=jax.tree.map(
                lambda values, column: values.at[:, slot].set(column[:, 0]), state.outlook, own
            )
        )

    def told(self, state: ControlState, action: Int[Array, "slots *batch"]) -> ControlState:
        """`instruct`, but without computing the outlook again."""
        told = self.may_stack(state, action)
        world = self.world.instruct(state.world, _clearance(state, jnp.where(told, action, NO_OP)))
        began = told & ~state.burst
        return state._replace(
            world=world,
            burst=state.burst | told,
            began=state.began | began,
            instructions=state.instructions + told.astype(jnp.float32),
            since_cycles=jnp.where(told, 0.0, state.since_cycles),
        )

    def advance(self, state: ControlState) -> tuple[ControlState, Outcome]:
        world, flown = self.world.advance(state.world)
        return self.end_cycle(state, world, flown, self.world.look_ahead(world))

    def end_cycle(
        self, state: ControlState, world: WorldState, flown: WorldCycle, outlook: Outlook
    ) -> tuple[ControlState, Outcome]:
        """`advance` for a cycle that has already been flown. `state` is the state before it."""
        heard = self.active(state)
        lost = subroutine(partial(_lost, self.sector), flown) & heard
        level_gap, exit_nm = _level_gap(world), self._exit_nm(world)
        stays = heard & world.traffic.active
        cycle = FlightCycle(
            transmission=state.began,
            instructions=state.instructions,
            time_to_loss_s=jnp.where(stays, outlook.time_s[CLEARED], jnp.inf),
            loss=lost & ~state.lost,
            excursion=flown.excursion & heard,
            exited=flown.exited & heard,
            level_error_ticks=jnp.abs(flown.traffic.level_ticks - flown.exit_level_ticks),
            nearer_level_ticks=jnp.where(stays, state.level_gap_ticks - level_gap, 0.0),
            nearer_exit_nm=jnp.where(stays, state.exit_nm - exit_nm, 0.0),
        )
        reward = jnp.where(heard, total_reward(self.reward, cycle), 0.0)
        terminated = heard & ~world.traffic.active
        ended = world.arrivals.cycle >= state.lasts
        instructed = state.instructions > 0.0
        since = jnp.where(instructed, 0.0, state.since_cycles) + 1.0
        totals = _added(state.totals, cycle, flown)
        # A newborn in a slot begins afresh.
        next_state = ControlState(
            world=world,
            outlook=outlook,
            burst=instructed & stays,
            began=jnp.zeros_like(state.began),
            instructions=jnp.zeros_like(state.instructions),
            since_cycles=jnp.where(stays, jnp.minimum(since, SINCE_CYCLES), SINCE_CYCLES),
            level_gap_ticks=level_gap,
            exit_nm=exit_nm,
            lost=lost & stays,
            totals=totals,
            lasts=state.lasts,
        )
        outcome = Outcome(
            reward=reward,
            terminated=terminated,
            truncated=ended[None] & ~terminated,
            ended=ended,
            metrics=_metrics(totals),
        )
        return next_state, outcome

    def step(
        self, state: ControlState, action: Int[Array, "slots *batch"]
    ) -> tuple[ControlState, Outcome]:
        return self.advance(self.instruct(state, action))

    def _exit_nm(self, world: WorldState) -> Float[Array, "slots *batch"]:
        return exit_distance(self.sector, world.traffic, memory_of(world))


def _clearance(state: ControlState, action: Int[Array, "slots *batch"]) -> Clearance:
    """What the actions clear flights to."""
    traffic = state.world.traffic
    heading = jnp.round(traffic.cleared_heading_deg)
    heading += jnp.where(action == LEFT_10, -TURN_DEG, TURN_DEG)
    turns = (action == LEFT_10) | (action == RIGHT_10)
    change = jnp.where(action == CLIMB, ticks(STEP_FL), -ticks(STEP_FL))
    return Clearance(
        turn=jnp.where(turns, SHORTEST, jnp.where(action == TO_FIX, DIRECT, NO_TURN)),
        heading_deg=wrap_360(heading),
        changes_level=(action == CLIMB) | (action == DESCEND),
        level_ticks=traffic.cleared_level_ticks + change,
        fix=state.world.progress.next_fix,
    )


def _level_gap(world: WorldState) -> Float[Array, "slots *batch"]:
    return jnp.abs(world.traffic.cleared_level_ticks - world.plan.exit_level_ticks)


def _lost(sector: Sector, flown: WorldCycle) -> Bool[Array, "slots *batch"]:
    """Which flights lost separation from another during the cycle."""
    after = flown.traffic
    squared = pair_distance_squared(
        sector.plane,
        sector.separation_fl,
        flown.before_nm,
        after.position_nm,
        flown.before_level_ticks,
        after.level_ticks,
    )
    one_active, other_active = first_and_second(after.active)
    lost = (squared < sector.loss_below_nm**2) & one_active & other_active
    one, other = np.triu_indices(after.active.shape[0], k=1)
    return jnp.zeros_like(after.active).at[one].max(lost).at[other].max(lost)


def _added(totals: Totals, cycle: FlightCycle, flown: WorldCycle) -> Totals:
    def count(flags: Array) -> Array:
        return jnp.sum(flags.astype(jnp.float32), axis=0)

    return Totals(
        left=totals.left + count(flown.exited | flown.excursion),
        correct=totals.correct + count(flown.exited_correctly),
        excursions=totals.excursions + count(flown.excursion),
        losses=totals.losses + count(cycle.loss),
        transmissions=totals.transmissions + count(cycle.transmission),
    )


def _metrics(totals: Totals) -> dict[str, Array]:
    left = jnp.maximum(totals.left, 1.0)
    return {
        "correct_exit": totals.correct / left,
        "excursion": totals.excursions / left,
        "losses": 1000.0 * totals.losses / left,
        "transmissions": totals.transmissions / left,
        "flights": totals.left,
    }
