"""Flight School: one hour of traffic per seed, in parallel processes, cached seed by seed.

The hour of a seed is hour 0 of that evaluation seed. Each finished seed is
stored in the folder `seeds` next to the tables, and is not flown again under equal conditions.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from scipy import stats

from skystack.agents.user_modules import imported_files
from skystack.errors import MAX_INT, InputError
from skystack.evaluation.controllers import ControlledWorld, find_controller
from skystack.evaluation.flown_seeds import (
    FlownSeed,
    conditions_digest,
    is_flown,
    read_seed,
    write_seed,
)
from skystack.evaluation.hour_row import ROW_FILE, write_row
from skystack.evaluation.hour_scores import Scores, score, summary
from skystack.evaluation.hour_tables import TABLES, FlownHour, tables_of
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.traffic import conditions_row, open_hours, record_of
from skystack.evaluation.traffic_conditions import TrafficConditions, check_conditions, cycles_of
from skystack.evaluation.workers import Report, run_in_workers
from skystack.evaluation.writing import growing_tables, table_metadata
from skystack.io.files import make_folder
from skystack.io.locks import delete_empty_on_failure, locked_folder

LIMIT_S = 60.0
"""The default limit for each cycle after the first: the agent's decision and the simulator's work.
The first may compile programs (`skystack.evaluation.workers.START_LIMIT_S`)."""
MOST_SEEDS = 100_000
SEEDS = "seeds"
"""The folder of the finished seeds."""
CONFIDENCE = 0.95


class FlightSchoolResult(NamedTuple):
    """What was flown."""

    row: dict[str, Any]
    """The results of the seeds that did not fail."""
    folder: Path
    failed: dict[int, str]
    """The seeds that failed, and why."""
    cached: int
    """The number of seeds that were already finished."""
    outdated: int
    """The number of seeds that were finished under other conditions, and flown again."""

    @property
    def failures(self) -> list[str]:
        """A line for each seed that failed: the seed and the reason."""
        return [f"seed {seed}, {reason}" for seed, reason in sorted(self.failed.items())]


class _Job(NamedTuple):
    """What a worker needs to fly seeds; picklable."""

    agent: str
    conditions: TrafficConditions
    folder: Path
    digest: str


def fly_flight_school(
    agent: str,
    conditions: TrafficConditions,
    seeds: Sequence[int],
    out: Path,
    limit_s: float = LIMIT_S,
    on_cycle: Callable[[int, int], None] = lambda flown, total: None,
) -> FlightSchoolResult:
    """Fly one hour of traffic for each seed, and write the tables into a subfolder of `out`.

    The seed and the number of hours in `conditions` are not used. `on_cycle` is called with the
    number of cycles flown so far and that of all cycles to fly. Raises InputError for an invalid
    agent or conditions, and if all seeds fail.
    """
    if not 0 < len(seeds) <= MOST_SEEDS:
        raise InputError(f"{len(seeds)} seeds (allowed: 1 to {MOST_SEEDS:,})")
    if min(seeds) < 0 or max(seeds) > MAX_INT:
        raise InputError(f"seeds {min(seeds)} to {max(seeds)} (allowed: 0 to {MAX_INT})")
    check_conditions(conditions._replace(hours=len(seeds)))
    found = find_controller(agent, conditions)
    folder = out / folder_name(found.name, conditions)
    # Absolute, because a user's controller may change the working directory.
    seed_folder = (folder / SEEDS).absolute()
    job = _Job(agent, conditions, seed_folder, conditions_digest(found, conditions))
    with delete_empty_on_failure(job.folder), locked_folder(folder, below=(SEEDS,)):
        make_folder(job.folder)
        cached = _finished(job, seeds)
        left = [seed for seed in seeds if seed not in cached]
        outdated = sum(is_flown(job.folder, seed) for seed in left)
        failed = _fly_others(job, left, limit_s, on_cycle, found.runs_user_code)
        flown = cached | _finished(job, [seed for seed in left if seed not in failed])
        flown = {seed: flown[seed] for seed in seeds if seed in flown}
        lost = [seed for seed in seeds if seed not in flown and seed not in failed]
        failed |= dict.fromkeys(lost, _cannot_be_read(job))
        if not flown:
            raise InputError(f"all seeds failed: seed {seeds[0]}, {failed[seeds[0]]}")
        _write_tables(folder, found, job, list(flown))
        row = _row(found, conditions, flown) | {"failed_seeds": sorted(failed)}
        write_row(folder, row)
    return FlightSchoolResult(row, folder, failed, len(cached), outdated)


def folder_name(agent: str, conditions: TrafficConditions) -> str:
    """The name of the folder of an agent's results under some conditions."""
    parts = [agent, "flight-school", conditions.traffic_in_names, *conditions.options_in_names]
    if conditions.cycles != cycles_of(conditions.traffic):
        parts.append(f"cycles-{conditions.cycles}")
    return "-".join(parts)


def _finished(job: _Job, seeds: Sequence[int]) -> dict[int, Scores]:
    """The scores of the seeds that are finished, in order."""
    found = ((seed, read_seed(job.folder, seed, job.digest)) for seed in seeds)
    return {seed: flown.scores for seed, flown in found if flown is not None}


def _fly_others(
    job: _Job,
    seeds: Sequence[int],
    limit_s: float,
    on_cycle: Callable[[int, int], None],
    process_per_seed: bool,
) -> dict[int, str]:
    """Fly seeds in parallel; returns those that failed, and why.

    With `process_per_seed`, every seed has its own process.
    """
    total, flown = len(seeds) * job.conditions.cycles, dict.fromkeys(seeds, 0)

    def on_report(seed: int, doing: str) -> None:
        flown[seed] += 1  # each cycle is reported
        on_cycle(sum(flown.values()), total)

    failed = {}
    if seeds:
        worker = partial(_worker, job)
        for finished in run_in_workers(worker, seeds, limit_s, on_report, process_per_seed):
            flown[finished.item] = job.conditions.cycles
            on_cycle(sum(flown.values()), total)
            if finished.failed is not None:
                failed[finished.item] = finished.failed
    return failed


def _worker(job: _Job) -> Callable[[int, Report], None]:
    """The function that flies a seed, in a worker process.

    Raises InputError if the controller or skystack has changed since the command was started.
    """
    found = find_controller(job.agent, job.conditions)
    if conditions_digest(found, job.conditions) != job.digest:
        raise InputError(
            f"{job.agent} or skystack has changed since the command was started (repeat it)"
        )
    hours = open_hours(found, job.conditions)
    flyer = HourFlyer(found.world, job.conditions.cycles, found.per_cycle, hours)

    def fly(seed: int, report: Report) -> None:
        files: dict[str, str] = {}

        def on_cycle(cycle: int) -> None:
            report(f"cycle {cycle}")
            if found.runs_user_code and not files:  # before they can be changed
                files.update(imported_files())

        hour = flyer.fly(found.agent, seed, 0, on_cycle)._replace(number=seed)
        if found.runs_user_code:
            files = imported_files() | files
        scores = score(found.world.sector, hour)
        tables = tables_of(FlownHour(found.world, hour, scores))
        write_seed(job.folder, seed, job.digest, FlownSeed(scores, tables, files))

    return fly


def _cannot_be_read(job: _Job) -> str:
    why = f"its results in {job.folder} cannot be read, or {job.agent} has changed"
    return f"{why} (repeat the command)"


def _write_tables(folder: Path, found: ControlledWorld, job: _Job, seeds: Sequence[int]) -> None:
    """Write the tables of finished seeds, one seed at a time, and delete the old row."""
    record = record_of(found, job.conditions._replace(seed=seeds[0]))
    metadata = table_metadata(found.world.sector, found.performance, traffic=record)
    with growing_tables(folder, TABLES, metadata, outdated=[folder / ROW_FILE]) as append:
        try:
            for seed in seeds:
                flown = read_seed(job.folder, seed, job.digest)
                if flown is None:
                    raise InputError(f"seed {seed}, {_cannot_be_read(job)}")
                append(flown.tables)
        except pa.ArrowException:
            raise InputError(
                f"{folder / SEEDS}: the tables have different columns (delete this folder)"
            ) from None


def _row(
    found: ControlledWorld, conditions: TrafficConditions, flown: Mapping[int, Scores]
) -> dict[str, Any]:
    row = summary(list(flown.values()), found.name, conditions.recorded_traffic)
    lax, strict = row["lax_s_by_hour"], row["strict_s_by_hour"]
    return (
        row
        | conditions_row(found, conditions._replace(seed=next(iter(flown))))
        | {
            "seeds": len(flown),
            "seed_numbers": list(flown),
            "lax_s_by_seed": lax,
            "strict_s_by_seed": strict,
            "lax_s_interval": interval(lax),
            "strict_s_interval": interval(strict),
        }
    )


def interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Student's 95 % confidence interval of the mean; None for fewer than two values."""
    if len(values) < 2:
        return None
    half = stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * stats.sem(values)
    return float(np.mean(values) - half), float(np.mean(values) + half)
