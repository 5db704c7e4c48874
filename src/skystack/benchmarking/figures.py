"""A measured quantity: its name, its configuration and all repetitions."""

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from skystack.io.json_file import finite


class Figure(NamedTuple):
    """Repeated measurements of one quantity."""

    name: str
    unit: str
    values: tuple[float, ...]
    """One value per repetition."""
    configuration: str
    """What is needed to repeat the measurement."""

    @property
    def median(self) -> float:
        return statistics.median(self.values)

    @property
    def as_json(self) -> dict[str, Any]:
        """The figure with its median and extremes; None for what is not finite."""
        return self._asdict() | {
            "values": tuple(map(finite, self.values)),
            "median": finite(self.median),
            "least": finite(min(self.values)),
            "greatest": finite(max(self.values)),
        }


def rates(run: Callable[[], Any], amount: float, repetitions: int) -> tuple[float, ...]:
    """The rate per second of a function that does `amount` per call, once per repetition.

    An additional first call warms up and is not counted.
    """
    run()
    measured = []
    for _ in range(repetitions):
        started = time.perf_counter()
        run()
        measured.append(amount / (time.perf_counter() - started))
    return tuple(measured)
