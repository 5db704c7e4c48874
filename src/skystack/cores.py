"""The processor cores that this process may use."""

import os
from collections.abc import Sequence


def cores() -> Sequence[int | None]:
    """Their numbers; [None] where the system does not tell which."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return [None] * (os.cpu_count() or 1)
