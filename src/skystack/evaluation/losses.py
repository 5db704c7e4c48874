"""Losses of separation between recorded flight paths with one row per cycle."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from skystack.airspace.projection import MercatorPlane
from skystack.airspace.sector import Sector
from skystack.compilation.shared import shared_program
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.separation import pair_distance_squared

_CYCLES = 128
"""The cycles computed at once, for all pairs. With blocks of a fixed length the program is compiled
once for each number of aircraft, and the pairs of 200 aircraft take little memory."""
_ROUNDED = 16
"""The number of aircraft in a block of cycles is rounded up to a multiple of this, because every
new number has to be compiled."""


class FlightPath(NamedTuple):
    """The path of one aircraft. It may begin later and end earlier than those of others."""

    position_nm: Float[np.ndarray, "rows 2"]
    """Positions in the sector's plane."""
    fl: Float[np.ndarray, " rows"]
    begins: int = 0
    """The row of the scenario in which the path begins."""

    @property
    def ends(self) -> int:
        """The row after the last one."""
        return self.begins + len(self.fl)


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
    last_row = max((each.ends for each in paths), default=1) - 1
    if len(paths) < 2 or not last_row:  # no pairs, or no motion
        return
    found = [_too_close(sector, paths, begin) for begin in range(0, last_row, _CYCLES)]
    close = _TooClose(*map(np.concatenate, zip(*found, strict=True)))
    pair = close.first * len(paths) + close.second
    order = np.lexsort((close.cycle, pair))
    close, pair = _TooClose(*(values[order] for values in close)), pair[order]
    begins = (np.diff(pair, prepend=-1) != 0) | (np.diff(close.cycle, prepend=-2) != 1)
    for run in np.split(np.arange(len(pair)), np.flatnonzero(begins)[1:]) if len(pair) else ():
        yield Loss(
            first=int(close.first[run[0]]),
            second=int(close.second[run[0]]),
            begins=int(close.cycle[run[0]]),
            ends=int(close.cycle[run[-1]]) + 1,
            least_nm=float(close.distance_nm[run].min()),
        )


def compiled_squared_nm2(plane: MercatorPlane, separation_fl: int) -> Any:
    """The pair distance, compiled once for all flights in a sector."""
    return shared_program(pair_distance_squared, plane, separation_fl)


class _TooClose(NamedTuple):
    """Pairs of aircraft that are too close between one row and the next."""

    first: Int[np.ndarray, " n"]
    second: Int[np.ndarray, " n"]
    cycle: Int[np.ndarray, " n"]
    """The first of the two rows."""
    distance_nm: Float[np.ndarray, " n"]


_NOBODY = np.zeros(0, dtype=np.int64)
_NONE = _TooClose(_NOBODY, _NOBODY, _NOBODY, np.zeros(0, dtype=np.float32))


def _too_close(sector: Sector, paths: Sequence[FlightPath], begin: int) -> _TooClose:
    """The pairs that are too close in a block of cycles."""
    rows = range(begin, begin + _CYCLES + 1)
    present = [n for n, each in enumerate(paths) if each.begins < rows[-1] and each.ends > begin]
    if len(present) < 2:
        return _NONE
    count = min(-(-len(present) // _ROUNDED) * _ROUNDED, len(paths))
    position = np.full((count, 2, len(rows)), np.nan, dtype=np.float32)
    level = np.full((count, len(rows)), np.nan, dtype=np.float32)
    for place, number in enumerate(present):
        path = paths[number]
        known = range(max(begin, path.begins), min(rows.stop, path.ends))
        into = slice(known.start - begin, known.stop - begin)
        values = slice(known.start - path.begins, known.stop - path.begins)
        position[place, :, into] = path.position_nm[values].T
        level[place, into] = np.rint(path.fl[values] * TICKS_PER_FL)
    squared_nm2 = compiled_squared_nm2(sector.plane, sector.separation_fl)
    moved = position[..., :-1], position[..., 1:], level[:, :-1], level[:, 1:]
    distance_nm = np.sqrt(np.asarray(squared_nm2(*moved)))
    # The distance is NaN where either path has not begun or has ended: not below the limit.
    pair, cycle = np.nonzero(distance_nm < sector.loss_below_nm)
    index = np.array([*present, *[0] * (count - len(present))], dtype=np.int64)
    first, second = (index[each][pair] for each in np.triu_indices(count, k=1))
    return _TooClose(first, second, begin + cycle, distance_nm[pair, cycle])
