"""A flight as the tasks see it: who is in the sector, and losses of separation, of any platform."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from skystack.airspace.sector import Sector
from skystack.evaluation.losses import FlightPath, losses
from skystack.platforms.conversion import traffic_of
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.tracking import Memory, Tracker

STATUS = ("before_entry", "in_sector", "exited", "excursion")


class Followed(NamedTuple):
    """What was seen of a flight."""

    status: Int[np.ndarray, "rows aircraft"]
    """Index in `STATUS`."""
    losses: int
    """How often two aircraft lost separation: cycles on end are one loss."""
    min_separation_nm: float
    """Least distance without vertical separation; infinite where everybody had it."""


def follow(scenario: Scenario, reports: Sequence[Report]) -> Followed:
    """Follow reported traffic by the tracker and the closed form that evaluations are judged by.

    As there, an aircraft that has exited is no longer watched.
    """
    sector, tracker = scenario.sector, Tracker(scenario.sector)
    before = scenario.initial_traffic(scenario.simulator())
    start = traffic_of(reports[0], before, sector.plane)
    exit_level_ticks = [ticks(aircraft.exit_fl) for aircraft in scenario.aircraft]
    traffic, memory = start, tracker.begin(start, jnp.array(exit_level_ticks, dtype=jnp.float32))
    look = jax.jit(partial(_look, tracker))
    rows = [_status(memory)]
    for report in reports[1:]:
        traffic, memory = look(memory, traffic_of(report, traffic, sector.plane))
        rows.append(_status(memory))
    status = np.stack(rows)
    lost = losses(sector, _watched(sector, reports, status))
    return Followed(status, sum(1 for _ in lost), float(memory.min_separation_nm))


def _watched(
    sector: Sector, reports: Sequence[Report], status: Int[np.ndarray, "rows aircraft"]
) -> list[FlightPath]:
    """Where each aircraft was up to the row in which it has exited."""
    lat, lon, fl = (np.stack([getattr(one, name) for one in reports]) for name in _PLACE)
    position_nm = sector.plane.to_plane(lat, lon)
    before_exit = np.sum(status != STATUS.index("exited"), axis=0)
    return [
        FlightPath(position_nm[: end + 1, number], fl[: end + 1, number])
        for number, end in enumerate(before_exit.tolist())
    ]


_PLACE = ("lat", "lon", "fl")


def status_of(
    entered: Bool[np.ndarray, "*n"],
    exited: Bool[np.ndarray, "*n"],
    excursion: Bool[np.ndarray, "*n"],
) -> Int[np.ndarray, "*n"]:
    """Index in `STATUS`; an aircraft that left the sector and later exits correctly has exited."""
    status = np.where(entered, 1, 0)
    status = np.where(excursion, 3, status)
    return np.where(exited, 2, status).astype(np.int8)


def _status(memory: Memory) -> Int[np.ndarray, " aircraft"]:
    return status_of(*map(np.asarray, (memory.entered, memory.exited, memory.excursion)))


def _look(tracker: Tracker, memory: Memory, flown: Traffic) -> tuple[Traffic, Memory]:
    memory = tracker.track(memory, flown)
    return flown._replace(active=flown.active & ~memory.exited), memory
