"""Counts of the instructions and bursts of a scenario."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.simulator.traffic import Traffic
from skystack.stacking import NO_OP

DAMPING_CYCLES = 10.0
"""n_max: the number of cycles after an instruction during which the damping reward is negative."""


class InstructionCounts(NamedTuple):
    """Counts so far. A burst is a run of the same instruction in consecutive cycles."""

    cycles_since_instruction: Float[Array, "aircraft *batch"]
    """n_s: 0 in the cycle of an instruction. Starts at n_max and is capped there."""
    instructed: Bool[Array, "aircraft *batch"]
    """Whether the aircraft has been instructed in the current cycle."""
    instructions: Float[Array, "aircraft *batch"]
    burst_action: Int[Array, "*batch"]
    """The instruction that would continue a burst; NO_OP if there is none."""
    bursts: Float[Array, "*batch"]
    new_bursts: Float[Array, "*batch"]
    """The bursts that started since the last cycle."""


def begin_counts(traffic: Traffic) -> InstructionCounts:
    """The counts at cycle 0."""
    zero = jnp.zeros(traffic.level_ticks.shape[1:], dtype=jnp.float32)
    return InstructionCounts(
        cycles_since_instruction=jnp.full_like(traffic.level_ticks, DAMPING_CYCLES),
        instructed=jnp.zeros_like(traffic.active),
        instructions=jnp.zeros_like(traffic.level_ticks),
        burst_action=zero.astype(jnp.int32),
        bursts=zero,
        new_bursts=zero,
    )


def count_instruction(
    counts: InstructionCounts,
    instructed: Bool[Array, "aircraft *batch"],
    action: Int[Array, "*batch"],
) -> InstructionCounts:
    """Count an action. `instructed` is a mask of the instructed aircraft: one, or none."""
    any_instructed = jnp.any(instructed, axis=0)
    new_burst = jnp.where(any_instructed & (action != counts.burst_action), 1.0, 0.0)
    return InstructionCounts(
        cycles_since_instruction=jnp.where(instructed, 0.0, counts.cycles_since_instruction),
        instructed=counts.instructed | instructed,
        instructions=counts.instructions + instructed.astype(jnp.float32),
        burst_action=jnp.where(any_instructed, action, counts.burst_action),
        bursts=counts.bursts + new_burst,
        new_bursts=counts.new_bursts + new_burst,
    )


def count_cycle(counts: InstructionCounts) -> InstructionCounts:
    """The counts after a cycle. A cycle without an instruction ends the burst."""
    increased = jnp.minimum(counts.cycles_since_instruction + 1.0, DAMPING_CYCLES)
    any_instructed = jnp.any(counts.instructed, axis=0)
    return counts._replace(
        cycles_since_instruction=jnp.where(counts.instructed, 0.0, increased),
        instructed=jnp.zeros_like(counts.instructed),
        burst_action=jnp.where(any_instructed, counts.burst_action, NO_OP),
        new_bursts=jnp.zeros_like(counts.new_bursts),
    )


def end_burst(counts: InstructionCounts) -> InstructionCounts:
    """End the burst, so that the next instruction starts a new one."""
    return counts._replace(burst_action=jnp.full_like(counts.burst_action, NO_OP))
