"""The processor: the cores that this process may use, and the system's description of it."""

import os
from collections.abc import Sequence
from pathlib import Path


def cores() -> Sequence[int | None]:
    """The numbers of the cores that this process may use; None for each if they are unknown."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return [None] * (os.cpu_count() or 1)


def processor_lines(*names: str) -> list[str]:
    """The lines of `/proc/cpuinfo` that start with one of the names; none on other systems."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []
    return [line for line in lines if line.startswith(names)]
