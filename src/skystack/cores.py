"""The processor cores that this process may use."""

import os
from collections.abc import Sequence

import jax


def cores() -> Sequence[int | None]:
    """Their numbers; [None] where the system does not tell which."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return [None] * (os.cpu_count() or 1)


def compile_for_one_core() -> None:
    """Make JAX's programs those of a machine with one core; before JAX is used.

    JAX splits sums among the cores that it sees, their number decides how they are rounded, and
    that decides how a training goes.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    everything = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(everything)})
    jax.devices()
    os.sched_setaffinity(0, everything)
