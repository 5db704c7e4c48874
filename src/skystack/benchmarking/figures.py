"""A figure of speed: what was measured, how often, and what came out."""

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple


class Figure(NamedTuple):
    """Repeated measurements of one thing."""

    name: str
    unit: str
    values: tuple[float, ...]
    """One a repetition."""
    configuration: str
    """Everything that somebody else would need to measure it again."""

    @property
    def median(self) -> float:
        return statistics.median(self.values)

    @property
    def as_json(self) -> dict[str, Any]:
        """The figure with its median and its extremes."""
        return self._asdict() | {
            "median": self.median,
            "least": min(self.values),
            "greatest": max(self.values),
        }


def rates(run: Callable[[], Any], amount: float, repetitions: int) -> tuple[float, ...]:
    """Amount a second of something that does that much; the first, uncounted run warms up."""
    run()
    found = []
    for _ in range(repetitions):
        begun = time.perf_counter()
        run()
        found.append(amount / (time.perf_counter() - begun))
    return tuple(found)
