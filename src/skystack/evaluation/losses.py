"""Losses of separation between recorded flight paths with one row per cycle."""

from collections.abc import Iterator, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from skystack.airspace.projection import MercatorPlane
from skystack.airspace.sector import Sector
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.separation import pair_distance_squared

_CYCLES = 128
"""The cycles computed at once, for all pairs. With blocks of a fixed length the program is compiled
once for each number of aircraft, and the pairs of 200 aircraft take little memory."""


class FlightPath(NamedTuple):
    """The path of one aircraft from the start (row 0). It may be shorter than those of others."""

    position_nm: Float[np.ndarray, "rows 2"]
    """Positions in the sector's plane."""
    fl: Float[np.ndarray, " rows"]


class Loss(NamedTuple):
    """A loss of separation: two aircraft and the rows between which they were too close."""

    first: int
    second: int
    begins: int
    ends: int
    least_nm: float


def losses(sector: Sector, paths: Sequence[FlightPath]) -> Iterator[Loss]:
    """The losses of all pairs, by the tasks' closed form between one row and the next.

    Consecutive cycles are one loss. Ordered by pair, then by time.
    """
    if len(paths) < 2:  # no pairs
        return
    indices, distances = [np.empty((0, 2), dtype=np.int64)], [np.empty(0, dtype=np.float32)]
    for begin, distance_nm in _distances_nm(sector, paths):
        too_close = distance_nm < sector.loss_below_nm
        indices.append(np.argwhere(too_close) + np.array([0, begin]))
        distances.append(distance_nm[too_close])
    (pair, cycle), least = np.concatenate(indices).T, np.concatenate(distances)
    order = np.lexsort((cycle, pair))
    pair, cycle, least = pair[order], cycle[order], least[order]
    begins = (np.diff(pair, prepend=-1) != 0) | (np.diff(cycle, prepend=-2) != 1)
    first, second = np.triu_indices(len(paths), k=1)
    for run in np.split(np.arange(len(pair)), np.flatnonzero(begins)[1:]) if len(pair) else ():
        number = pair[run[0]]
        yield Loss(
            first=int(first[number]),
            second=int(second[number]),
            begins=int(cycle[run[0]]),
            ends=int(cycle[run[-1]]) + 1,
            least_nm=float(least[run].min()),
        )


@cache
def compiled_squared_nm2(plane: MercatorPlane, separation_fl: int) -> Any:
    """The pair distance, compiled once for all flights in a sector."""
    return jax.jit(partial(pair_distance_squared, plane, separation_fl))


def _distances_nm(
    sector: Sector, paths: Sequence[FlightPath]
) -> Iterator[tuple[int, Float[np.ndarray, "pairs cycles"]]]:
    """Blocks of cycles: the first cycle, and the minimum distance of each pair in each cycle.

    NaN if the path of one of the two has ended.
    """
    rows = max(2, *(len(each.fl) for each in paths))
    rows += (1 - rows) % _CYCLES  # whole blocks, and the row that ends the last one
    position = np.stack([_padded(each.position_nm.T, rows) for each in paths])
    level = np.stack([_padded(np.rint(each.fl * TICKS_PER_FL), rows) for each in paths])
    squared_nm2 = compiled_squared_nm2(sector.plane, sector.separation_fl)
    for begin in range(0, rows - 1, _CYCLES):
        before, after = (slice(at, at + _CYCLES) for at in (begin, begin + 1))
        cycles = position[..., before], position[..., after], level[..., before], level[..., after]
        yield begin, np.sqrt(np.asarray(squared_nm2(*cycles)))


def _padded(values: Float[np.ndarray, "*axes rows"], rows: int) -> Float[np.ndarray, "*axes all"]:
    """The values padded with NaN, which compares as not too close."""
    widths = [(0, 0)] * (values.ndim - 1) + [(0, rows - values.shape[-1])]
    return np.pad(values, widths, constant_values=np.nan).astype(np.float32)
