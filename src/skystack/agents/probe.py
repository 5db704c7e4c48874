"""Trial plans for one flight, flown ahead with the simulator and checked against the traffic.

A plan is a few clearances with the cycles at which they are to be issued. `Probe.fly` flies many
plans of a flight at once, to their exits; `Probe.conflicts` finds the flights from which they would
not be separated.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.agents.transmission import TURNS, Transmission
from skystack.airspace.geometry import Components
from skystack.compilation.shared import shared_program
from skystack.simulator.simulator import Simulator, instruct
from skystack.simulator.traffic import DIRECT, NO_TURN, Clearance, Traffic, ticks
from skystack.tasks.flight_time import flight_times
from skystack.tasks.progress import FlightPlan, Progress, ProgressTracker
from skystack.tasks.sector_world import World, WorldState, makes_excursion
from skystack.tasks.separation import half_length, least_distance_squared

PLANS = 32
"""The number of plans flown at once."""
EVENTS = 3
"""The maximum number of clearances of a plan."""
AHEAD = 240
"""The least value of `Probe.ahead`."""
DETOUR = 1.25
"""Plans are flown ahead for at most this factor times the flight time of the longest route, so that
plans with detours also reach their exits."""
LOW_FL = 100
"""That time is computed at or above this level. Flights are lower only briefly, near airports."""
NEVER = 100_000
"""The cycle of an event that is not used."""


_Pairs = tuple[Components, Array, Array]


class Events(NamedTuple):
    """The clearances of plans. Cycles are relative to the present."""

    cycle: Int[np.ndarray, "plans events"]
    turn: Int[np.ndarray, "plans events"]
    heading_deg: Float[np.ndarray, "plans events"]
    fix: Int[np.ndarray, "plans events"]
    changes_level: Bool[np.ndarray, "plans events"]
    level_ticks: Float[np.ndarray, "plans events"]


def no_events(plans: int) -> Events:
    """Plans without clearances."""
    number, zero = np.zeros((plans, EVENTS), np.int32), np.zeros((plans, EVENTS), np.float32)
    return Events(number + NEVER, number + NO_TURN, zero, number, zero > 0.0, zero.copy())


def set_event(
    events: Events, plan: int, index: int, cycle: int, transmission: Transmission
) -> None:
    """Set an event of a plan: a transmission that is issued in a cycle."""
    events.cycle[plan, index] = cycle
    if transmission.fix is not None:
        events.turn[plan, index], events.fix[plan, index] = DIRECT, transmission.fix
    if transmission.heading_deg is not None:
        events.turn[plan, index] = TURNS[transmission.turn]
        events.heading_deg[plan, index] = transmission.heading_deg
    if transmission.level_ticks is not None:
        events.changes_level[plan, index] = True
        events.level_ticks[plan, index] = transmission.level_ticks


def flights_in(state: WorldState, slots: Int[np.ndarray, " rows"]) -> tuple[Any, Any, Any]:
    """The traffic, progress and flight plans of the flights in some slots, for `Probe.fly`.

    Rates of climb are nominal: a controller does not know how those of a flight differ.
    """

    def pick(values: np.ndarray) -> np.ndarray:
        return values if values.ndim == 0 else values[slots]  # the number of cycles flown is one

    traffic, progress, plan = jax.tree.map(pick, (state.traffic, state.progress, state.plan))
    return traffic._replace(climb_factor=np.ones_like(traffic.climb_factor)), progress, plan


class Ahead(NamedTuple):
    """Flights flown ahead, as numpy or JAX arrays. Index 0 of the cycles is the present."""

    position_nm: Any
    """`[cycles, flights, 2]`."""
    level_ticks: Any
    """`[cycles, flights]`."""
    present: Any
    """`[cycles, flights]`: whether the flight is still there."""


class FlownPlans(NamedTuple):
    """Plans flown ahead."""

    ahead: Ahead
    correct: Any
    """`[plans]`: whether the flight leaves through its exit, at its exit level."""
    cycles: Any
    """`[plans]`: the number of cycles until it leaves."""


class Conflicts(NamedTuple):
    """Conflicts of plans with other flights, `[plans, others]`, as numpy or JAX arrays.

    Two flights are in conflict if they are closer than the separation standard plus a margin, and
    lose separation if they are closer than the standard.
    """

    first: Any
    """The first cycle of a conflict, or NEVER."""
    first_loss: Any
    """The first cycle of a loss of separation, or NEVER."""
    cycles_of_loss: Any
    """The number of cycles in which separation is lost."""
    least_squared: Any
    """The square of the least distance without vertical separation, in square NM; infinite if they
    are always vertically separated."""
    least_cycle: Any
    """The cycle in which it is reached."""


@dataclass(frozen=True)
class Probe:
    """Flies plans in a world with its own simulator."""

    world: World
    margin_nm: float = 0.25
    """Added to the separation standard for conflicts."""

    @cached_property
    def ahead(self) -> int:
        """The maximum number of cycles flown ahead."""
        lowest, highest = self.world.sector.levels_fl
        levels_fl = (min(max(lowest, LOW_FL), highest), highest)
        times = flight_times(self.world.simulator, levels_fl, disc_nm=0.0)
        return max(AHEAD, int(DETOUR * times.slowest.max()))

    @cached_property
    def fly(self) -> Any:
        """(traffic, progress, flight_plan, events) -> FlownPlans, compiled.

        All have one row per plan.
        """
        return shared_program(_fly, self.world.simulator, self.world.tracker, self.ahead)

    @cached_property
    def conflicts(self) -> Any:
        """(plans, others) -> `Conflicts`, compiled."""
        sector = self.world.sector
        least_nm = sector.separation_nm, sector.separation_nm + self.margin_nm
        return shared_program(_conflicts, sector.plane, least_nm, ticks(sector.separation_fl))


def _fly(
    simulator: Simulator,
    tracker: ProgressTracker,
    cycles: int,
    traffic: Traffic,
    progress: Progress,
    flight_plan: FlightPlan,
    events: Any,
) -> FlownPlans:
    """Fly all plans until the last one has ended, for at most `cycles` cycles.

    `events` are `Events`.
    """

    shape = (cycles + 1, *traffic.level_ticks.shape)
    ahead = Ahead(
        position_nm=jnp.zeros((*shape, 2)).at[0].set(traffic.position_nm),
        level_ticks=jnp.zeros(shape).at[0].set(traffic.level_ticks),
        present=jnp.zeros(shape, dtype=bool).at[0].set(traffic.active),
    )

    def flies(carry: tuple[Int[Array, ""], Traffic, Progress, Ahead]) -> Bool[Array, ""]:
        cycle, traffic, _, _ = carry
        return (cycle < cycles) & jnp.any(traffic.active)

    def fly_cycle(
        carry: tuple[Int[Array, ""], Traffic, Progress, Ahead],
    ) -> tuple[Int[Array, ""], Traffic, Progress, Ahead]:
        cycle, traffic, progress, ahead = carry
        for event in range(EVENTS):
            due = events.cycle[:, event] == cycle
            clearance = Clearance(
                turn=jnp.where(due, events.turn[:, event], NO_TURN),
                heading_deg=events.heading_deg[:, event],
                changes_level=due & events.changes_level[:, event],
                level_ticks=events.level_ticks[:, event],
                fix=events.fix[:, event],
            )
            traffic = instruct(traffic, clearance)
        flown = simulator.advance(traffic)
        progress = tracker.update(progress, flight_plan, flown)
        ended = progress.exited | makes_excursion(simulator.sector, progress, flown)
        cycle += 1
        ahead = Ahead(
            ahead.position_nm.at[cycle].set(flown.position_nm),
            ahead.level_ticks.at[cycle].set(flown.level_ticks),
            ahead.present.at[cycle].set(flown.active),
        )
        return cycle, flown._replace(active=flown.active & ~ended), progress, ahead

    _, _, progress, ahead = jax.lax.while_loop(
        flies, fly_cycle, (jnp.int32(0), traffic, progress, ahead)
    )
    correct = progress.exited_correctly & ~progress.excursion
    return FlownPlans(ahead, correct, jnp.sum(ahead.present[1:].astype(jnp.int32), axis=0))


def _conflicts(
    plane: Any,
    least_nm: tuple[float, float],
    least_ticks: float,
    plans: Ahead,
    others: Ahead,
) -> Conflicts:
    """When and for how long each plan is not separated from each other flight.

    `least_nm` is the separation standard, without and with the margin.
    """

    def half(ahead: Ahead) -> Array:
        """Half the true length of a unit of the plane at each flight, `[cycles, flights]`."""
        north = ahead.position_nm[..., 1]
        return half_length(plane, north.reshape(-1)).reshape(north.shape)

    half_mine, half_other = half(plans), half(others)

    def pairs(index: Int[Array, ""]) -> _Pairs:
        """True offset, vertical gap, and whether both are present, `[plans, others]`."""
        mine, other = plans.position_nm[index], others.position_nm[index]
        length = half_mine[index][:, None] + half_other[index][None]
        offset = Components(
            (mine[:, 0, None] - other[None, :, 0]) * length,
            (mine[:, 1, None] - other[None, :, 1]) * length,
        )
        gap = plans.level_ticks[index][:, None] - others.level_ticks[index][None]
        return offset, gap, plans.present[index][:, None] & others.present[index][None]

    last = jnp.sum(jnp.any(plans.present, axis=1).astype(jnp.int32))

    def step(
        carry: tuple[Int[Array, ""], _Pairs, Conflicts],
    ) -> tuple[Int[Array, ""], _Pairs, Conflicts]:
        index, (offset, gap, both), found = carry
        after = pairs(index)
        offset_after, gap_after, both_after = after
        squared = least_distance_squared(
            offset, offset_after.minus(offset), gap, gap_after, least_ticks
        )
        apart = jnp.where(both & both_after, squared, jnp.inf)
        lost, close = (apart < nm**2 for nm in least_nm)
        found = Conflicts(
            jnp.minimum(found.first, jnp.where(close, index, NEVER)),
            jnp.minimum(found.first_loss, jnp.where(lost, index, NEVER)),
            found.cycles_of_loss + lost.astype(jnp.int32),
            jnp.minimum(found.least_squared, apart),
            jnp.where(apart < found.least_squared, index, found.least_cycle),
        )
        return index + 1, after, found

    shape = (plans.level_ticks.shape[1], others.level_ticks.shape[1])
    none = jnp.zeros(shape, dtype=jnp.int32)
    nothing = Conflicts(none + NEVER, none + NEVER, none, jnp.full(shape, jnp.inf), none)
    start = (jnp.int32(1), pairs(jnp.int32(0)), nothing)
    _, _, found = jax.lax.while_loop(lambda carry: carry[0] < last, step, start)
    return found
