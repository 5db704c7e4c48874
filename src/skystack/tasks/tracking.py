"""What a task remembers beside the traffic: fixes passed, entry, exit, excursions, counts.

`track` needs only the traffic that a simulator reports, so it serves any simulator.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import closest_approach, crosses_outward, inside_area
from skystack.airspace.sector import Sector
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.contract import NO_ACTION
from skystack.tasks.rewards import DAMPING_CYCLES

PASSED_NM = 1.0
"""A fix is passed within this distance."""
SEPARATION_NM = 5.0
SEPARATION_FL = 10.0
"""Vertical separation: 1,000 ft."""


class Memory(NamedTuple):
    """One scenario's past, as far as the task needs it."""

    exit_level: Float[Array, " aircraft"]
    """Ticks, like every level."""
    entry_level: Float[Array, " aircraft"]
    previous_nm: Float[Array, "aircraft 2"]
    previous_level: Float[Array, " aircraft"]
    next_fix: Int[Array, " aircraft"]
    """Index in the route; starts at 1, never goes back, stays at the last."""
    cycles_since_instruction: Float[Array, " aircraft"]
    """n_s: 0 in the cycle of an instruction; starts at, and is capped to, n_max."""
    instructed: Bool[Array, " aircraft"]
    """In this cycle, so far."""
    instructions: Float[Array, " aircraft"]
    entered: Bool[Array, " aircraft"]
    strayed: Bool[Array, " aircraft"]
    exited: Bool[Array, " aircraft"]
    exited_correctly: Bool[Array, " aircraft"]
    min_separation_nm: Float[Array, ""]
    burst_action: Int[Array, ""]
    """The instruction that would continue a burst; NO_ACTION if none would."""
    bursts: Float[Array, ""]
    new_bursts: Float[Array, ""]
    """Begun since the last cycle."""
    cycles: Float[Array, ""]


@dataclass(frozen=True)
class Tracker:
    """Keeps the memory of scenarios in one sector."""

    sector: Sector

    def begin(self, traffic: Traffic, exit_level: Float[Array, " aircraft"]) -> Memory:
        """The memory at cycle 0."""
        none = jnp.zeros_like(traffic.active)
        zero = jnp.zeros((), dtype=jnp.float32)
        return Memory(
            exit_level=exit_level,
            entry_level=traffic.level,
            previous_nm=traffic.position_nm,
            previous_level=traffic.level,
            next_fix=self._next_fix(traffic, jnp.ones_like(traffic.route)),
            cycles_since_instruction=jnp.full_like(traffic.level, DAMPING_CYCLES),
            instructed=none,
            instructions=jnp.zeros_like(traffic.level),
            entered=self._inside(traffic),
            strayed=none,
            exited=none,
            exited_correctly=none,
            min_separation_nm=zero + jnp.inf,
            burst_action=jnp.zeros((), dtype=jnp.int32),
            bursts=zero,
            new_bursts=zero,
            cycles=zero,
        )

    def note_instruction(
        self, memory: Memory, heard: Bool[Array, " aircraft"], action: Int[Array, ""]
    ) -> Memory:
        """Count an instruction for the aircraft that heard it: one, or none."""
        any_heard = jnp.any(heard)
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
        inside = self._inside(traffic)
        exits = traffic.active & memory.entered & self._crosses_exit(memory, traffic)
        at_exit_level = traffic.level == memory.exit_level
        strays = traffic.active & memory.entered & ~inside & ~exits
        waited = jnp.minimum(memory.cycles_since_instruction + 1.0, DAMPING_CYCLES)
        return memory._replace(
            previous_nm=traffic.position_nm,
            previous_level=traffic.level,
            next_fix=self._next_fix(traffic, memory.next_fix),
            cycles_since_instruction=jnp.where(memory.instructed, 0.0, waited),
            instructed=jnp.zeros_like(memory.instructed),
            entered=memory.entered | (traffic.active & inside),
            strayed=memory.strayed | strays,
            exited=memory.exited | exits,
            exited_correctly=memory.exited_correctly | (exits & at_exit_level),
            min_separation_nm=jnp.minimum(memory.min_separation_nm, separation_nm(memory, traffic)),
            burst_action=jnp.where(jnp.any(memory.instructed), memory.burst_action, NO_ACTION),
            new_bursts=jnp.zeros_like(memory.new_bursts),
            cycles=memory.cycles + 1.0,
        )

    def _inside(self, traffic: Traffic) -> Bool[Array, " aircraft"]:
        lowest, highest = (ticks(fl) for fl in self.sector.levels_fl)
        level_ok = (traffic.level >= lowest) & (traffic.level <= highest)
        area = jnp.asarray(self.sector.area_nm, dtype=jnp.float32)
        return level_ok & inside_area(traffic.position_nm, area)

    def _crosses_exit(self, memory: Memory, traffic: Traffic) -> Bool[Array, " aircraft"]:
        edge = jnp.asarray(self.sector.route_table.exit_edge_nm)[traffic.route]
        return crosses_outward(memory.previous_nm, traffic.position_nm, edge)

    def _next_fix(
        self, traffic: Traffic, next_fix: Int[Array, " aircraft"]
    ) -> Int[Array, " aircraft"]:
        """Skip every fix passed: near it, or beyond the plane that halves its legs."""
        table = self.sector.route_table
        fixes = jnp.asarray(table.fixes_nm)[traffic.route]
        bisector = jnp.asarray(table.bisector)[traffic.route]
        last = jnp.asarray(table.last_fix)[traffic.route][:, None]
        beyond = traffic.position_nm[:, None, :] - fixes
        passed = (jnp.sum(beyond * beyond, axis=-1) < PASSED_NM**2) | (
            jnp.sum(beyond * bisector, axis=-1) > 0.0
        )
        index = jnp.arange(fixes.shape[1])[None, :]
        waits = (index >= next_fix[:, None]) & (~passed | (index >= last))
        return jnp.argmax(waits, axis=1).astype(next_fix.dtype)


def separation_nm(memory: Memory, traffic: Traffic) -> Float[Array, ""]:
    """Least distance in the last cycle of any two active aircraft less than 1,000 ft apart.

    Closed form for straight motion from one radar position to the next (a turn bends it by less
    than 0.02 NM); infinite if no two aircraft were so close vertically.
    """
    first, second = jnp.triu_indices(traffic.level.shape[0], k=1)
    if first.shape[0] == 0:
        return jnp.full((), jnp.inf)

    def pairs(values: Array) -> Array:
        return values[first] - values[second]

    offset = pairs(memory.previous_nm)
    motion = pairs(traffic.position_nm) - offset
    gap = pairs(memory.previous_level) / TICKS_PER_FL
    climb = pairs(traffic.level) / TICKS_PER_FL - gap
    # The part of the cycle, from 0 to 1, in which |gap + climb * time| < 10 levels.
    moving = jnp.where(climb == 0.0, 1.0, climb)
    low, high = (-SEPARATION_FL - gap) / moving, (SEPARATION_FL - gap) / moving
    level_close = jnp.abs(gap) < SEPARATION_FL
    begins = jnp.where(climb == 0.0, jnp.where(level_close, 0.0, 2.0), jnp.minimum(low, high))
    ends = jnp.where(climb == 0.0, 1.0, jnp.maximum(low, high))
    distance = closest_approach(offset, motion, jnp.maximum(begins, 0.0), jnp.minimum(ends, 1.0))
    both = traffic.active[first] & traffic.active[second]
    return jnp.min(jnp.where(both, distance, jnp.inf))
