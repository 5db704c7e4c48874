"""Losses of separation of flights that are given as rows, one a cycle."""

from collections.abc import Iterator, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from skystack.airspace.projection import MercatorPlane
from skystack.airspace.sector import Sector
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.tracking import pair_distance_squared

_CYCLES = 128
"""Of all pairs at once: the program is compiled once for a number of aircraft, not for every
length, and the pairs of 200 aircraft take little memory."""


class FlightPath(NamedTuple):
    """Where one aircraft was, row 0 the start; it may end before others do."""

    position_nm: Float[np.ndarray, "rows 2"]
    """In the sector's plane."""
    fl: Float[np.ndarray, " rows"]


class Loss(NamedTuple):
    """A loss of separation: two aircraft, and the rows between which they were too close."""

    first: int
    second: int
    begins: int
    ends: int
    least_nm: float


def losses(sector: Sector, paths: Sequence[FlightPath]) -> Iterator[Loss]:
    """By the tasks' own closed form, for every pair from one row to the next.

    Consecutive cycles are one loss; ordered by pair, then by time.
    """
    if len(paths) < 2:  # no pair
        return
    found = [np.empty((0, 2), dtype=np.int64)], [np.empty(0, dtype=np.float32)]
    for begin, distance_nm in _distances_nm(sector, paths):
        close = distance_nm < sector.loss_below_nm
        found[0].append(np.argwhere(close) + np.array([0, begin]))
        found[1].append(distance_nm[close])
    (pair, cycle), least = np.concatenate(found[0]).T, np.concatenate(found[1])
    order = np.lexsort((cycle, pair))
    pair, cycle, least = pair[order], cycle[order], least[order]
    begins = (np.diff(pair, prepend=-1) != 0) | (np.diff(cycle, prepend=-2) != 1)
    first, second = np.triu_indices(len(paths), k=1)
    for run in np.split(np.arange(len(pair)), np.flatnonzero(begins)[1:]) if len(pair) else ():
        which, ends = pair[run[0]], int(cycle[run[-1]]) + 1
        yield Loss(
            int(first[which]), int(second[which]), int(cycle[run[0]]), ends, float(least[run].min())
        )


@cache
def _squared_nm2(plane: MercatorPlane, separation_fl: int) -> Any:
    """Compiled once for all flights in a sector."""
    return jax.jit(partial(pair_distance_squared, plane, separation_fl))


def _distances_nm(
    sector: Sector, paths: Sequence[FlightPath]
) -> Iterator[tuple[int, Float[np.ndarray, "pairs cycles"]]]:
    """Blocks of cycles: the number of the first, and the least distance of each pair in each cycle.

    NaN where one of the two has no more rows.
    """
    rows = max(2, *(len(each.fl) for each in paths))
    rows += (1 - rows) % _CYCLES  # whole blocks, and the row in which the last one ends
    place = np.stack([_filled(each.position_nm.T, rows) for each in paths])
    level = np.stack([_filled(np.rint(each.fl * TICKS_PER_FL), rows) for each in paths])
    squared_nm2 = _squared_nm2(sector.plane, sector.separation_fl)
    for begin in range(0, rows - 1, _CYCLES):
        before, after = (slice(at, at + _CYCLES) for at in (begin, begin + 1))
        cycles = place[..., before], place[..., after], level[..., before], level[..., after]
        yield begin, np.sqrt(np.asarray(squared_nm2(*cycles)))


def _filled(values: Float[np.ndarray, "*axes rows"], rows: int) -> Float[np.ndarray, "*axes all"]:
    """What is filled in is no number, and close to nothing."""
    widths = [(0, 0)] * (values.ndim - 1) + [(0, rows - values.shape[-1])]
    return np.pad(values, widths, constant_values=np.nan).astype(np.float32)
