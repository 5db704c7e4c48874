"""A flight as the tasks see it: who is in the sector, and losses of separation, of any platform."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from skystack.airspace.geometry import first_and_second
from skystack.airspace.sector import Sector
from skystack.platforms.conversion import traffic_of
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.tracking import Memory, Tracker, pair_distance_squared

STATUS = ("before_entry", "in_sector", "exited", "strayed")


class Followed(NamedTuple):
    """What was seen of a flight."""

    status: Int[np.ndarray, "rows aircraft"]
    """Index in `STATUS`."""
    losses: int
    """How often two aircraft lost separation: cycles on end are one loss."""
    min_separation_nm: float
    """Least distance without vertical separation; infinite where everybody had it."""


class _Sight(NamedTuple):
    """After a cycle."""

    traffic: Traffic
    memory: Memory
    close: Bool[Array, " pairs"]
    """Pairs that had lost separation in the cycle."""
    losses: Int[Array, ""]
    """Begun so far."""


def follow(scenario: Scenario, reports: Sequence[Report]) -> Followed:
    """Follow reported traffic by the tracker and the closed form that evaluations are judged by.

    As there, an aircraft that has exited is no longer watched.
    """
    sector, tracker = scenario.sector, Tracker(scenario.sector)
    before = scenario.initial_traffic(scenario.simulator())
    start = traffic_of(reports[0], before, sector.plane)
    exit_level = [ticks(aircraft.exit_fl) for aircraft in scenario.aircraft]
    memory = tracker.begin(start, jnp.array(exit_level, dtype=jnp.float32))
    pairs = len(exit_level) * (len(exit_level) - 1) // 2
    sight = _Sight(start, memory, jnp.zeros(pairs, dtype=bool), jnp.zeros((), dtype=jnp.int32))
    look = jax.jit(partial(_look, tracker))
    status = [_status(memory)]
    for report in reports[1:]:
        sight = look(sight, traffic_of(report, sight.traffic, sector.plane))
        status.append(_status(sight.memory))
    least = float(sight.memory.min_separation_nm)
    return Followed(np.stack(status), int(sight.losses), least)


def status_of(
    entered: Bool[np.ndarray, "*n"], exited: Bool[np.ndarray, "*n"], strayed: Bool[np.ndarray, "*n"]
) -> Int[np.ndarray, "*n"]:
    """Index in `STATUS`; whoever strayed and came out right has exited."""
    status = np.where(entered, 1, 0)
    status = np.where(strayed, 3, status)
    return np.where(exited, 2, status).astype(np.int8)


def _status(memory: Memory) -> Int[np.ndarray, " aircraft"]:
    return status_of(*map(np.asarray, (memory.entered, memory.exited, memory.strayed)))


def _look(tracker: Tracker, sight: _Sight, flown: Traffic) -> _Sight:
    memory = tracker.track(sight.memory, flown)
    close = _close(tracker.sector, sight.memory, flown)
    begun = jnp.sum(close & ~sight.close, dtype=jnp.int32)
    active = flown.active & ~memory.exited
    return _Sight(flown._replace(active=active), memory, close, sight.losses + begun)


def _close(sector: Sector, memory: Memory, flown: Traffic) -> Bool[Array, " pairs"]:
    """Which pairs have lost separation in the cycle from the memory to the traffic."""
    if flown.level.shape[0] < 2:
        return jnp.zeros(0, dtype=bool)
    squared = pair_distance_squared(
        sector.plane,
        sector.separation_fl,
        memory.previous_nm,
        flown.position_nm,
        memory.previous_level,
        flown.level,
    )
    one, other = first_and_second(flown.active)
    return one & other & (jnp.sqrt(squared) < sector.loss_below_nm)
