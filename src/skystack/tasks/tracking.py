"""What a task remembers beside the traffic: fixes passed, entry, exit, excursions, counts.

`track` needs only the traffic that a simulator reports, so it serves any simulator.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Shaped

from skystack.airspace.geometry import (
    closest_approach_squared,
    crosses_outward,
    distance_right_of_route,
    dot,
    first_and_second,
    inside_area,
    point_of,
    points_of,
    value_of,
)
from skystack.airspace.projection import MercatorPlane
from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.contract import NO_OP
from skystack.tasks.rewards import DAMPING_CYCLES

PASSED_NM = 1.0
"""A fix is passed within this distance."""
MOST_UNROLLED = 16
"""Most fixes of a route to unroll in compiled programs; longer ones become a loop."""


class Memory(NamedTuple):
    """One scenario's past, as far as the task needs it."""

    exit_level_ticks: Float[Array, "aircraft *batch"]
    """Ticks, like every level."""
    entry_level_ticks: Float[Array, "aircraft *batch"]
    previous_nm: Float[Array, "aircraft 2 *batch"]
    previous_level_ticks: Float[Array, "aircraft *batch"]
    next_fix: Int[Array, "aircraft *batch"]
    """Index in the route; starts at 1, never goes back, stays at the last."""
    cycles_since_instruction: Float[Array, "aircraft *batch"]
    """n_s: 0 in the cycle of an instruction; starts at, and is capped to, n_max."""
    instructed: Bool[Array, "aircraft *batch"]
    """In this cycle, so far."""
    instructions: Float[Array, "aircraft *batch"]
    entered: Bool[Array, "aircraft *batch"]
    excursion: Bool[Array, "aircraft *batch"]
    exited: Bool[Array, "aircraft *batch"]
    exited_correctly: Bool[Array, "aircraft *batch"]
    separation_nm: Float[Array, "*batch"]
    """In the last cycle, see `separation_nm` below; infinite before the first."""
    min_separation_nm: Float[Array, "*batch"]
    burst_action: Int[Array, "*batch"]
    """The instruction that would continue a burst; NO_OP if none would."""
    bursts: Float[Array, "*batch"]
    new_bursts: Float[Array, "*batch"]
    """Begun since the last cycle."""
    cycles: Float[Array, "*batch"]


@dataclass(frozen=True)
class Tracker:
    """Keeps the memory of scenarios in one sector."""

    sector: Sector

    def begin(self, traffic: Traffic, exit_level_ticks: Float[Array, "aircraft *batch"]) -> Memory:
        """The memory at cycle 0."""
        none = jnp.zeros_like(traffic.active)
        zero = jnp.zeros(traffic.level_ticks.shape[1:], dtype=jnp.float32)
        return Memory(
            exit_level_ticks=exit_level_ticks,
            entry_level_ticks=traffic.level_ticks,
            previous_nm=traffic.position_nm,
            previous_level_ticks=traffic.level_ticks,
            next_fix=traffic.next_fix,
            cycles_since_instruction=jnp.full_like(traffic.level_ticks, DAMPING_CYCLES),
            instructed=none,
            instructions=jnp.zeros_like(traffic.level_ticks),
            entered=self._inside(traffic),
            excursion=none,
            exited=none,
            exited_correctly=none,
            separation_nm=zero + jnp.inf,
            min_separation_nm=zero + jnp.inf,
            burst_action=zero.astype(jnp.int32),
            bursts=zero,
            new_bursts=zero,
            cycles=zero,
        )

    def note_instruction(
        self, memory: Memory, heard: Bool[Array, "aircraft *batch"], action: Int[Array, "*batch"]
    ) -> Memory:
        """Count an instruction for the aircraft that heard it: one, or none."""
        any_heard = jnp.any(heard, axis=0)
        new_burst = jnp.where(any_heard & (action != memory.burst_action), 1.0, 0.0)
        return memory._replace(
            cycles_since_instruction=jnp.where(heard, 0.0, memory.cycles_since_instruction),
            instructed=memory.instructed | heard,
            instructions=memory.instructions + heard.astype(jnp.float32),
            burst_action=jnp.where(any_heard, action, memory.burst_action),
            bursts=memory.bursts + new_burst,
            new_bursts=memory.new_bursts + new_burst,
        )

    def track(self, memory: Memory, traffic: Traffic) -> Memory:
        """Judge one cycle from the traffic after it; `traffic.active` still is as before it."""
        inside = subroutine(self._inside, traffic)
        exits = traffic.active & memory.entered & subroutine(self._crosses_exit, memory, traffic)
        separation = subroutine(partial(separation_nm, self.sector), memory, traffic)
        at_exit_level = traffic.level_ticks == memory.exit_level_ticks
        strays = traffic.active & memory.entered & ~inside & ~exits
        waited = jnp.minimum(memory.cycles_since_instruction + 1.0, DAMPING_CYCLES)
        return memory._replace(
            previous_nm=traffic.position_nm,
            previous_level_ticks=traffic.level_ticks,
            next_fix=subroutine(self._next_fix, traffic, memory.next_fix),
            cycles_since_instruction=jnp.where(memory.instructed, 0.0, waited),
            instructed=jnp.zeros_like(memory.instructed),
            entered=memory.entered | (traffic.active & inside),
            excursion=memory.excursion | strays,
            exited=memory.exited | exits,
            exited_correctly=memory.exited_correctly | (exits & at_exit_level),
            separation_nm=separation,
            min_separation_nm=jnp.minimum(memory.min_separation_nm, separation),
            burst_action=jnp.where(jnp.any(memory.instructed, axis=0), memory.burst_action, NO_OP),
            new_bursts=jnp.zeros_like(memory.new_bursts),
            cycles=memory.cycles + 1.0,
        )

    def _inside(self, traffic: Traffic) -> Bool[Array, "aircraft *batch"]:
        lowest, highest = (ticks(fl) for fl in self.sector.levels_fl)
        level_ok = (traffic.level_ticks >= lowest) & (traffic.level_ticks <= highest)
        return level_ok & inside_area(traffic.position_nm, self.sector.area_nm)

    def _crosses_exit(self, memory: Memory, traffic: Traffic) -> Bool[Array, "aircraft *batch"]:
        crossed = jnp.zeros_like(traffic.active)
        for edge in pairwise(points_of(self.sector.route_table.exit_edge_nm, traffic.route)):
            crossed |= crosses_outward(memory.previous_nm, traffic.position_nm, *edge)
        return crossed

    def _next_fix(
        self, traffic: Traffic, next_fix: Int[Array, "aircraft *batch"]
    ) -> Int[Array, "aircraft *batch"]:
        """Skip every fix passed: near it, or beyond the plane that halves its legs.

        At a turn of more than 90 degrees that plane also cuts the leg to the fix; there an aircraft
        is past it only once it is nearer to the leg that follows.
        """
        table = self.sector.route_table
        near_nm = PASSED_NM * self.sector.plane.scale(traffic.position_nm[:, 1])
        last = value_of(table.last_fix, traffic.route)
        longest = table.fixes_nm.shape[1]
        if longest > MOST_UNROLLED:  # unrolled, it would take minutes to compile

            def passed(found: Int[Array, "aircraft *batch"]) -> Bool[Array, "aircraft *batch"]:
                return (found < last) & self._passed(traffic, near_nm, found)

            found: Int[Array, "aircraft *batch"] = jax.lax.while_loop(
                lambda found: jnp.any(passed(found)),
                lambda found: found + passed(found).astype(found.dtype),
                next_fix,
            )
            return found
        found = last
        for index in reversed(range(longest)):
            passed_here = self._passed(traffic, near_nm, index)
            waits = (index >= next_fix) & (index < last) & ~passed_here
            found = jnp.where(waits, index, found)
        return found

    def _passed(
        self,
        traffic: Traffic,
        near_nm: Float[Array, "aircraft *batch"],
        index: int | Int[Array, "aircraft *batch"],
    ) -> Bool[Array, "aircraft *batch"]:
        """Whether each aircraft is past a fix of its route."""
        table = self.sector.route_table

        def fix(index: int | Int[Array, "aircraft *batch"]) -> Float[Array, "aircraft 2 *batch"]:
            return _of_route(table.fixes_nm, traffic.route, index)

        beyond = traffic.position_nm - fix(index)
        past = dot(beyond, _of_route(table.bisector, traffic.route, index)) > 0.0
        sharp = table.sharp[:, index] if isinstance(index, int) else table.sharp
        if sharp.any():
            before, after = (
                jnp.abs(distance_right_of_route(traffic.position_nm, (fix(first), fix(first + 1))))
                for first in (index - 1, index)
            )
            past &= (after < before) | ~_of_route(table.sharp, traffic.route, index)
        return past | (dot(beyond, beyond) < near_nm**2)


def _of_route(
    values: Shaped[np.ndarray, "routes fixes *vector"],
    route: Int[Array, "aircraft *batch"],
    fix: int | Int[Array, "aircraft *batch"],
) -> Array:
    """The table's entry for a fix of each aircraft's route."""
    look_up = value_of if values.ndim == 2 else point_of
    if isinstance(fix, int):
        return look_up(values[:, fix], route)
    fixes = values.shape[1]
    index = route * fixes + jnp.clip(fix, 0, fixes - 1)
    return look_up(values.reshape(-1, *values.shape[2:]), index)


def separation_nm(sector: Sector, memory: Memory, traffic: Traffic) -> Float[Array, "*batch"]:
    """Least distance in the last cycle of any two active aircraft without vertical separation.

    Closed form for straight motion from one radar position to the next (a turn bends it by less
    than 0.02 NM); infinite if every two aircraft were separated vertically.
    """
    if traffic.level_ticks.shape[0] < 2:
        return jnp.full_like(memory.cycles, jnp.inf)
    squared = pair_distance_squared(
        sector.plane,
        sector.separation_fl,
        memory.previous_nm,
        traffic.position_nm,
        memory.previous_level_ticks,
        traffic.level_ticks,
    )
    one, other = first_and_second(traffic.active)
    # Of the least only: a root for every pair costs as much as the rest of it.
    return jnp.sqrt(jnp.min(jnp.where(one & other, squared, jnp.inf), axis=0))


def pair_distance_squared(
    plane: MercatorPlane,
    separation_fl: int,
    previous_nm: Float[ArrayLike, "aircraft 2 *batch"],
    position_nm: Float[ArrayLike, "aircraft 2 *batch"],
    previous_level_ticks: Float[ArrayLike, "aircraft *batch"],
    level_ticks: Float[ArrayLike, "aircraft *batch"],
) -> Float[Array, "pairs *batch"]:
    """Square [NM2] of the least distance of every pair in a cycle, as above; levels in ticks.

    Only instants count at which the two are less than `separation_fl` apart. Whether
    there are any is decided on whole ticks, which float32 holds exactly however it is compiled.
    """

    def pairs(values: ArrayLike) -> tuple[Array, Array]:
        return first_and_second(jnp.asarray(values))

    def true_offset(position_nm: ArrayLike) -> Array:
        at = jnp.asarray(position_nm)
        first, second = first_and_second(at)
        # The mean of both is that half-way, within a part in ten thousand 20 NM apart at 75 N.
        half, other_half = first_and_second(0.5 / plane.scale(at[:, 1]))
        return (first - second) * (half + other_half)[:, None]

    offset = true_offset(previous_nm)
    motion = true_offset(position_nm) - offset
    (first, second), (first_after, second_after) = pairs(previous_level_ticks), pairs(level_ticks)
    gap, gap_after = first - second, first_after - second_after
    limit = ticks(separation_fl)
    passes = (gap > 0.0) != (gap_after > 0.0)  # one level is crossed by the other
    close = passes | (jnp.minimum(jnp.abs(gap), jnp.abs(gap_after)) < limit)
    # The part of the cycle, from 0 to 1, in which |gap + climb * time| < limit, if there is any.
    climb = gap_after - gap
    time_a_tick = 1.0 / jnp.where(climb == 0.0, 1.0, climb)
    low, high = (-limit - gap) * time_a_tick, (limit - gap) * time_a_tick
    begins = jnp.maximum(jnp.minimum(low, high), 0.0)
    ends = jnp.minimum(jnp.maximum(low, high), 1.0)
    return jnp.where(close, closest_approach_squared(offset, motion, begins, ends), jnp.inf)
