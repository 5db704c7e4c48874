"""All figures. Parts are measured in new processes, so that they share no memory or programs."""

import math
import multiprocessing
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple, TypeVar

from skystack.benchmarking.decisions import decision_figures
from skystack.benchmarking.figures import Figure
from skystack.benchmarking.sector import sector_figures, sector_training_figures
from skystack.benchmarking.simulator import simulator_figures
from skystack.benchmarking.starting import starting_figures
from skystack.benchmarking.training import (
    SCENARIOS,
    SUCCESS,
    accelerator_figures,
    reaches_success,
    training_figures,
)
from skystack.errors import InputError

FASTEST_EXPERIMENT = "lateral-best"
"""The experiment that learns lateral navigation in the shortest time."""

SECTOR = {"traffic and decisions": sector_figures, "training": sector_training_figures}
"""The parts of sector control, and the functions that measure them."""

Result = TypeVar("Result")


class Effort(NamedTuple):
    """How much is measured."""

    repetitions: int = 7
    processes: int = 3
    """The number of repetitions of measurements that need a new process each."""
    scenarios: int = 20
    trainings: tuple[str, ...] = ("lateral", "lateral-best", "avoidance", "avoidance-best")
    aircraft: tuple[int, ...] = (2, 10, 50, 200)
    seeds: int = 3
    """The number of training runs for the time to success."""
    sector: bool = True
    """Whether sector control is measured."""


QUICK = Effort(1, 1, scenarios=1, trainings=("lateral",), aircraft=(2,), seeds=0, sector=False)
"""A minimal effort, as a check."""


class Part(NamedTuple):
    """What is measured before the next progress message."""

    group: str
    """One of `skystack.benchmarking.groups.GROUPS`."""
    title: str
    measure: Callable[[], list[Figure]]


def parts(effort: Effort, groups: Collection[str] | None = None) -> list[Part]:
    """What is measured of some groups, or of all.

    Raises InputError for a group that this effort lacks.
    """
    times = effort.repetitions
    found = [
        Part("start", "start", partial(starting_figures, effort.processes)),
        Part("simulator", "simulator", partial(alone, simulator_figures, effort.aircraft, times)),
        *(
            Part("training", f"training, {name}", partial(alone, training_figures, name, times))
            for name in effort.trainings
        ),
        *(
            Part("gpu", f"on a GPU, {name}", partial(alone, accelerator_figures, name, times))
            for name in effort.trainings
        ),
        *[Part("success", "time to success", partial(success_figures, effort.seeds))]
        * (effort.seeds > 0),
        *[
            Part("sector", f"sector control, {what}", partial(alone, measure, times))
            for what, measure in SECTOR.items()
            if effort.sector
        ],
        Part(
            "decisions",
            "decisions",
            partial(alone, decision_figures, FASTEST_EXPERIMENT, effort.scenarios),
        ),
    ]
    measured = groups_of(found)
    for group in groups or ():
        if group not in measured:
            raise InputError(f"--quick does not measure {group} (allowed: {', '.join(measured)})")
    return [part for part in found if groups is None or part.group in groups]


def groups_of(measured: Sequence[Part]) -> tuple[str, ...]:
    """The groups of some parts, in order."""
    return tuple(dict.fromkeys(part.group for part in measured))


def measure_skystack(
    effort: Effort, on_part: Callable[[str], None], groups: Collection[str] | None = None
) -> list[Figure]:
    """Skystack's figures of some groups, or of all.

    `on_part` is called with the title of each part before it starts. Raises InputError for a
    group that this effort lacks.
    """
    figures: list[Figure] = []
    for part in parts(effort, groups):
        on_part(part.title)
        figures += part.measure()
    return figures


def alone(measure: Callable[..., Result], *arguments: Any) -> Result:
    """The function's result, computed in a new process."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure, *arguments).result()


def success_figures(seeds: int) -> list[Figure]:
    """Seconds from the start of a process until its training reaches success, for each seed."""
    values = []
    for seed in range(seeds):
        started = time.perf_counter()
        reached = alone(reaches_success, FASTEST_EXPERIMENT, seed)
        values.append(time.perf_counter() - started if reached else math.inf)
    setup = (
        f"`{FASTEST_EXPERIMENT}`, seeds from 0, including imports and compilation, until {SUCCESS} "
        f"on {SCENARIOS} held-out scenarios, stacked"
    )
    return [Figure(f"time to success {SUCCESS}", "s", tuple(values), setup)]
