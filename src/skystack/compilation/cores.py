"""The processor: the cores that this process may use, and what the system says of them."""

import os
from collections.abc import Sequence
from pathlib import Path


def cores() -> Sequence[int | None]:
    """Their numbers; [None] where the system does not tell which."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return [None] * (os.cpu_count() or 1)


def processor_lines(*names: str) -> list[str]:
    """The lines of Linux's `/proc/cpuinfo` that begin with one of the names; elsewhere none."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []
    return [line for line in lines if line.startswith(names)]
