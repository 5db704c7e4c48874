"""All figures, each group in a process of its own: none meets another's memory or programs."""

import math
import multiprocessing
import platform
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple, TypeVar

from skystack.benchmarking.decisions import decision_figures
from skystack.benchmarking.figures import Figure
from skystack.benchmarking.simulator import simulator_figures
from skystack.benchmarking.starting import starting_figures
from skystack.benchmarking.training import (
    SCENARIOS,
    SUCCESS,
    accelerator_figures,
    reaches_success,
    training_figures,
)
from skystack.compilation.cores import cores, processor_lines
from skystack.learning.policy import package_versions

SOONEST = "lateral-best"
"""The configuration that learns lateral navigation soonest."""

Result = TypeVar("Result")


class Effort(NamedTuple):
    """How often things are measured."""

    repetitions: int = 7
    processes: int = 3
    """Of what takes a process of its own each time."""
    scenarios: int = 20
    trainings: tuple[str, ...] = ("lateral", "lateral-best", "avoidance", "avoidance-best")
    aircraft: tuple[int, ...] = (2, 10, 50, 200)
    seeds: int = 3
    """For the time to success."""


QUICK = Effort(1, 1, scenarios=1, trainings=("lateral",), aircraft=(2,), seeds=0)
"""To see that it works."""


def measure_ourselves(effort: Effort, told: Callable[[str], None]) -> list[Figure]:
    """Our own figures; `told` is called with what is about to be measured."""
    groups: list[tuple[str, Callable[[], list[Figure]]]] = [
        ("start", partial(starting_figures, effort.processes)),
        ("simulator", partial(alone, simulator_figures, effort.aircraft, effort.repetitions)),
        *(
            (f"training, {name}", partial(alone, training_figures, name, effort.repetitions))
            for name in effort.trainings
        ),
        ("training on a GPU", partial(alone, accelerator_figures, "lateral", effort.repetitions)),
        *[("time to success", partial(success_figures, effort.seeds))] * (effort.seeds > 0),
        ("decisions", partial(alone, decision_figures, SOONEST, effort.scenarios)),
    ]
    figures: list[Figure] = []
    for title, measure in groups:
        told(title)
        figures += measure()
    return figures


def alone(measure: Callable[..., Result], *arguments: Any) -> Result:
    """The function's result from a fresh process."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure, *arguments).result()


def success_figures(seeds: int) -> list[Figure]:
    """Seconds from the start of a process until training in it has led to success, by seed."""
    values = []
    for seed in range(seeds):
        begun = time.perf_counter()
        reached = alone(reaches_success, SOONEST, seed)
        values.append(time.perf_counter() - begun if reached else math.inf)
    how = (
        f"`{SOONEST}`, seeds from 0, imports and compilation included, until {SUCCESS} on "
        f"{SCENARIOS} held-out scenarios, stacked"
    )
    return [Figure(f"time to success {SUCCESS}", "s", tuple(values), how)]


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "system": platform.platform(terse=True),
        "processor": _processor(),
        "cores": len(cores()),
        "python": platform.python_version(),
        "packages": package_versions(),
        "date": time.strftime("%Y-%m-%d"),
    }


def _processor() -> str:
    named = [line.partition(":")[2].strip() for line in processor_lines("model name")]
    return named[0] if named else platform.processor() or platform.machine()
