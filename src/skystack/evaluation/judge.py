"""Judge one controller on held-out scenarios: fly, write the tables, reduce them to a row."""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import pyarrow as pa

from skystack.airspace.sector_file import SectorEntry
from skystack.errors import InputError
from skystack.evaluation.elsewhere import FlownElsewhere, Job, fly_elsewhere
from skystack.evaluation.rollout import NOBODY, Controller, fly, network_controller
from skystack.evaluation.summary import Row, summarise
from skystack.evaluation.tables import make_tables
from skystack.files import make_folder
from skystack.learning.experiment import Experiment, experiment_from
from skystack.learning.policy import Policy
from skystack.platforms.processes import TIME_LIMIT_S
from skystack.platforms.registry import (
    OWN,
    adoption_of,
    check_platform,
    flown_type,
    open_platform,
    said_of,
)
from skystack.tasks.build import build_task
from skystack.tasks.navigation import NavigationTask

DO_NOTHING = "do-nothing"


class Conditions(NamedTuple):
    """How a controller is judged."""

    seed: int = 0
    """Of the scenarios."""
    episodes: int = 1000
    stacking: bool = True
    greedy: bool = True
    platform: str = OWN
    time_limit_s: float = TIME_LIMIT_S
    """For one scenario on another platform."""
    sector: str | SectorEntry | None = None
    """Another sector than the one that it was trained in."""


class Judged(NamedTuple):
    """A row and the scenarios behind it."""

    row: Row
    episodes: pa.Table
    clearances: pa.Table
    failed: dict[int, str]
    """Scenarios that the platform did not finish, and why; they are in neither."""
    notes: tuple[str, ...] = ()
    """What the platform flew in another way than the task asks for, in lines for the user."""


def task_of(policy: Policy, sector: str | SectorEntry | None = None) -> NavigationTask:
    """The task that a policy was trained for, as it is flown; in another sector if one is given.

    Raises InputError when this version's task is another one than the policy's, or cannot be flown
    in that sector.
    """
    described = policy.description
    where = f"policy {described.experiment}-s{described.seed}"
    experiment: Experiment = experiment_from(described.config, where)
    settings = experiment.task
    if sector is not None:
        settings = msgspec.structs.replace(settings, sector=sector)
    task = build_task(settings)
    if (described.task_name, described.task_version) != (task.name, task.version):
        raise InputError(
            f"{where} was trained for task {described.task_name} version "
            f"{described.task_version} (allowed: {task.name} version {task.version}); train it anew"
        )
    if described.observation != task.observation_names or described.actions != task.action_names:
        raise InputError(f"{where}: its observation or actions are not those of its task")
    return task


def judge(
    policy: Policy,
    conditions: Conditions,
    out: Path | None,
    on_scenario: Callable[[int], None] = lambda done: None,
) -> Judged:
    """Fly a policy on the scenarios of an evaluation seed; `out` is the folder for evaluations.

    `on_scenario` hears how many scenarios another platform has done. Raises InputError for a
    platform that is not there, PlatformError when it finishes no scenario.
    """
    check_platform(conditions.platform)
    described, task = policy.description, task_of(policy, conditions.sector)
    controller = partial(network_controller, policy.actor, policy.normaliser, conditions.greedy)
    name, seed = described.experiment, described.seed
    return _judge(name, seed, task, controller, conditions, out, on_scenario)


def judge_nobody(experiment: Experiment, conditions: Conditions, out: Path | None) -> Judged:
    """The same scenarios with no instructions at all."""
    task = build_task(experiment.task)
    plain = conditions._replace(stacking=False)
    return _judge(DO_NOTHING, 0, task, lambda: NOBODY, plain, out, lambda done: None)


def evaluation_folder(
    out: Path, experiment: str, seed: int, stacking: bool, platform: str = OWN
) -> Path:
    """Where the tables of an evaluation lie."""
    kind = "stacked" if stacking else "plain"
    return out / f"{experiment}-s{seed}-{platform}-{kind}"


def _judge(
    name: str,
    trained_seed: int,
    task: NavigationTask,
    controller: Callable[[], Controller],
    conditions: Conditions,
    out: Path | None,
    on_scenario: Callable[[int], None],
) -> Judged:
    """Fly, make the tables, write them where wanted, and reduce them to the row."""
    begun = time.monotonic()
    platform, stacking = conditions.platform, conditions.stacking
    if platform == OWN:
        here = fly(task, controller(), conditions.seed, conditions.episodes, stacking)
        flown = FlownElsewhere(here, {})
    else:
        flown = _fly_elsewhere(task, controller, conditions, out, on_scenario)
    wall_s = time.monotonic() - begun
    flown_as, adoption = partial(flown_type, platform), adoption_of(platform)
    tables = make_tables(task, flown.recording, flown_as, adoption)
    if out is not None:
        folder = evaluation_folder(out, name, trained_seed, stacking, platform)
        settings = task.settings
        tables.write(folder, task.simulator.sector, settings.performance, settings.fleet)
    row = summarise(
        name, trained_seed, platform, stacking, conditions.greedy, wall_s, tables.episodes
    )
    climbs = task.actions.kind == "level"
    notes = tuple(said_of(platform, task.simulator.performance.types, climbs))
    return Judged(row, tables.episodes, tables.clearances, flown.failed, notes)


def _fly_elsewhere(
    task: NavigationTask,
    controller: Callable[[], Controller],
    conditions: Conditions,
    out: Path | None,
    on_scenario: Callable[[int], None],
) -> FlownElsewhere:
    """Fly on another platform; its own files lie where the system keeps what is thrown away."""
    job = Job(
        task,
        controller,
        conditions.stacking,
        conditions.seed,
        partial(open_platform, conditions.platform),
    )
    if out is not None:
        make_folder(out)  # refused before anything is flown, which takes long
    with tempfile.TemporaryDirectory(prefix="skystack-") as work:
        return fly_elsewhere(
            job, conditions.episodes, Path(work), conditions.time_limit_s, on_scenario
        )
