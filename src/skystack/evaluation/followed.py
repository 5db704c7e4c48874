"""The status of aircraft and the losses of separation in a flight on any platform."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Int

from skystack.airspace.sector import Sector
from skystack.compilation.shared import shared_program
from skystack.evaluation.losses import FlightPath, losses
from skystack.platforms.conversion import traffic_of
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.tracking import Memory, Tracker

STATUS = ("before_entry", "in_sector", "exited", "excursion")


class TrackedFlight(NamedTuple):
    """The findings of the tasks' tracker and separation check for a flight."""

    status: Int[np.ndarray, "rows aircraft"]
    """Index in `STATUS`."""
    losses: int
    """The number of losses of separation: consecutive cycles of a pair are one loss."""
    min_separation_nm: float
    """The minimum distance without vertical separation; infinite if all pairs always had it."""


def follow(scenario: Scenario, reports: Sequence[Report]) -> TrackedFlight:
    """Evaluate reported traffic with the tracker and the closed form that the tasks use.

    As in the tasks, an aircraft that has exited is ignored.
    """
    sector, tracker = scenario.sector, Tracker(scenario.sector)
    before = scenario.initial_traffic(scenario.simulator())
    start = traffic_of(reports[0], before, sector.plane)
    exit_level_ticks = [ticks(aircraft.exit_fl) for aircraft in scenario.aircraft]
    traffic, memory = start, tracker.begin(start, jnp.array(exit_level_ticks, dtype=jnp.float32))
    track = shared_program(_track, tracker)
    rows = [_status(memory)]
    for report in reports[1:]:
        traffic, memory = track(memory, traffic_of(report, traffic, sector.plane))
        rows.append(_status(memory))
    status = np.stack(rows)
    found = losses(sector, _paths_to_exit(sector, reports, status))
    return TrackedFlight(status, sum(1 for _ in found), float(memory.separation.least_nm))


def _paths_to_exit(
    sector: Sector, reports: Sequence[Report], status: Int[np.ndarray, "rows aircraft"]
) -> list[FlightPath]:
    """The path of each aircraft, up to the row in which it has exited."""
    lat, lon, fl = (
        np.stack([getattr(report, name) for report in reports]) for name in ("lat", "lon", "fl")
    )
    position_nm = sector.plane.to_plane(lat, lon)
    before_exit = np.sum(status != STATUS.index("exited"), axis=0)
    return [
        FlightPath(position_nm[: end + 1, number], fl[: end + 1, number])
        for number, end in enumerate(before_exit.tolist())
    ]


def status_of(
    entered: Bool[ArrayLike, "*n"], exited: Bool[ArrayLike, "*n"], excursion: Bool[ArrayLike, "*n"]
) -> Int[np.ndarray, "*n"]:
    """Index in `STATUS`. An aircraft that exits correctly after an excursion has exited."""
    status = np.where(entered, 1, 0)
    status = np.where(excursion, 3, status)
    return np.where(exited, 2, status).astype(np.int8)


def _status(memory: Memory) -> Int[np.ndarray, " aircraft"]:
    progress = memory.progress
    return status_of(progress.entered, progress.exited, progress.excursion)


def _track(tracker: Tracker, memory: Memory, flown: Traffic) -> tuple[Traffic, Memory]:
    memory = tracker.track(memory, flown)
    return flown._replace(active=flown.active & ~memory.progress.exited), memory
