"""A flown scenario file as an evaluation would judge it: each row's status, and the losses."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from skystack.evaluation.losses import FlightPath, Loss, losses
from skystack.evaluation.tables import STATUS, status_of
from skystack.platforms.flight import Flight
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.traffic import Traffic
from skystack.tasks.tracking import Memory, Tracker


class Judged(NamedTuple):
    """What an evaluation would say of it."""

    status: Int[np.ndarray, "rows aircraft"]
    """Index in `skystack.evaluation.tables.STATUS`."""
    losses: tuple[Loss, ...]
    """While both aircraft have not exited."""


def judge_flight(scenario: Scenario, flight: Flight) -> Judged:
    """Track a flight on any platform by the rules of the tasks."""
    sector = scenario.sector
    position_nm = np.stack([sector.plane.to_plane(each.lat, each.lon) for each in flight.reports])
    fl = np.stack([each.fl for each in flight.reports])
    status = _status(scenario, position_nm, fl)
    exited = status == STATUS.index("exited")
    # An aircraft is in the sector's traffic up to the row in which it has exited.
    rows = np.where(exited.any(axis=0), exited.argmax(axis=0) + 1, len(status)).tolist()
    paths = [
        FlightPath(position_nm[:end, number], fl[:end, number]) for number, end in enumerate(rows)
    ]
    return Judged(status, tuple(losses(sector, paths)))


def _status(
    scenario: Scenario, position_nm: np.ndarray, fl: np.ndarray
) -> Int[np.ndarray, "rows aircraft"]:
    tracker = Tracker(scenario.sector)
    traffic = scenario.initial_traffic(scenario.simulator())
    exit_level = jnp.array([one.exit_fl * TICKS_PER_FL for one in scenario.aircraft])
    begun = tracker.begin(traffic, exit_level)

    def cycle(
        carry: tuple[Traffic, Memory], row: tuple[Array, Array]
    ) -> tuple[tuple[Traffic, Memory], tuple[Array, Array, Array]]:
        traffic, memory = carry
        traffic = traffic._replace(position_nm=row[0], level=row[1])
        memory = tracker.track(memory, traffic)
        traffic = traffic._replace(active=traffic.active & ~memory.exited)
        return (traffic, memory), (memory.entered, memory.exited, memory.strayed)

    rows = (
        jnp.asarray(position_nm[1:], dtype=jnp.float32),
        jnp.asarray(np.rint(fl[1:] * TICKS_PER_FL), dtype=jnp.float32),
    )
    _, judged = jax.jit(lambda start, rows: jax.lax.scan(cycle, start, rows))(
        (traffic, begun), rows
    )
    entered, exited, strayed = (
        np.concatenate([np.asarray(first)[None], np.asarray(later)])
        for first, later in zip((begun.entered, begun.exited, begun.strayed), judged, strict=True)
    )
    return status_of(entered, exited, strayed)
