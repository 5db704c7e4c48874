"""The registry of metrics, `METRICS`, with the unit and description of each."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool

from skystack.tasks.contract import Metric
from skystack.tasks.rewards import MAX_INSTRUCTIONS
from skystack.tasks.tracking import Memory


class MetricEntry(NamedTuple):
    """A metric: its function, unit and description."""

    value: Callable[[Memory, Bool[Array, "*batch"]], Array]
    """Maps the memory, and whether all criteria are satisfied, to the metric `[*batch]`."""
    unit: str
    description: str


METRICS: dict[str, MetricEntry] = {
    "success": MetricEntry(
        lambda memory, success: success,
        "true or false",
        "all criteria of the task are satisfied for all aircraft",
    ),
    "correct_exit": MetricEntry(
        lambda memory, success: jnp.all(memory.progress.exited_correctly, axis=0),
        "true or false",
        "all aircraft left through their exit at their exit level",
    ),
    "excursion": MetricEntry(
        lambda memory, success: jnp.any(memory.progress.excursion, axis=0),
        "true or false",
        "an aircraft left the sector other than through its exit, or never entered it",
    ),
    "few_instructions": MetricEntry(
        lambda memory, success: jnp.all(memory.counts.instructions < MAX_INSTRUCTIONS, axis=0),
        "true or false",
        f"every aircraft received fewer than {MAX_INSTRUCTIONS:g} instructions",
    ),
    "instructions": MetricEntry(
        lambda memory, success: jnp.sum(memory.counts.instructions, axis=0),
        "count",
        "instructions to all aircraft",
    ),
    "bursts": MetricEntry(
        lambda memory, success: memory.counts.bursts,
        "count",
        "runs of the same instruction in consecutive cycles, or within one stack",
    ),
    "min_separation_nm": MetricEntry(
        lambda memory, success: memory.separation.least_nm,
        "NM",
        "minimum distance between two active aircraft without vertical separation; infinite if "
        "there is none",
    ),
    "cycles": MetricEntry(
        lambda memory, success: memory.progress.cycles, "count", "radar cycles flown"
    ),
}

SPECIFICATIONS = {name: Metric(each.unit, each.description) for name, each in METRICS.items()}


def measure(memory: Memory, success: Bool[Array, "*batch"]) -> dict[str, Array]:
    """The values of all metrics."""
    return {name: each.value(memory, success) for name, each in METRICS.items()}
