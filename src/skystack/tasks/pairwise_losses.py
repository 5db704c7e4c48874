"""When flights lose separation from their neighbours, on predicted paths and levels."""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.prediction import HORIZON_S, TIMES_S, PredictedPath

INTERVALS = len(TIMES_S) - 1
"""At most 32: sets of intervals are stored as bits."""

Bits = Any
Tree = TypeVar("Tree")


class Cleared(NamedTuple):
    """Flights predicted as cleared."""

    path: PredictedPath
    level_ticks: Float[Array, "times columns"]


class Others(NamedTuple):
    """All flights as cleared, in the form in which each flight is compared with others."""

    cleared: Cleared
    table: Float[Array, "rows columns"]
    """Positions east, then north, then levels, at all predicted times."""
    there: Bits
    """The intervals that begin before each flight has left, `[columns]`."""


class Neighbours(NamedTuple):
    """The flights that each flight is compared with."""

    column: Int[Array, "neighbours chosen"]
    exists: Bool[Array, "neighbours chosen"]


def others_of(cleared: Cleared) -> Others:
    """All flights as cleared, ready to be compared with."""
    table = (cleared.path.east_nm, cleared.path.north_nm, cleared.level_ticks)
    return Others(cleared, jnp.concatenate(table), _before(cleared.path.until_s))


def columns_of(values: Tree, column: Int[Array, " chosen"]) -> Tree:
    """The columns, on the last axis, of all arrays of a pytree."""
    chosen: Tree = jax.tree.map(lambda each: each[..., column], values)
    return chosen


def times_to_loss(
    sector: Sector,
    margin_nm: float,
    all_ways: bool,
    traffic: Traffic,
    path: PredictedPath,
    height: Float[Array, "times levels chosen"],
    others: Others,
    neighbours: Neighbours,
) -> tuple[Array, Array]:
    """The time to the first loss for each way, and as cleared for each neighbour.

    The arrays of `path` have an axis for several paths before that of the flights. The first path
    and level are those as cleared, and with `all_ways`, the second path is direct.
    The ways are then, in this order: every path at the cleared level, the path as cleared at every
    other level, and direct at the second level. Losses are stored as sets of intervals between the
    predicted times, one bit per interval.
    """
    chosen = neighbours.column.shape[1]
    inverse = 1.0 / sector.plane.scale(traffic.position_nm[:, 1])
    there = _before(path.until_s)
    below2 = (sector.separation_nm + margin_nm) ** 2
    limit = ticks(float(sector.separation_fl))

    def close(east: Array, north: Array, other_east: Array, other_north: Array) -> Bits:
        """The intervals in which each path comes too close, `[laterals, chosen]`."""
        bits = jnp.zeros(east.shape[1:], dtype=jnp.uint32)
        x = (east[0] - other_east[0][None]) * inverse[None]
        y = (north[0] - other_north[0][None]) * inverse[None]
        for number in range(INTERVALS):
            x_after = (east[number + 1] - other_east[number + 1][None]) * inverse[None]
            y_after = (north[number + 1] - other_north[number + 1][None]) * inverse[None]
            dx, dy = x_after - x, y_after - y
            approach = -(x * dx + y * dy) / jnp.maximum(dx * dx + dy * dy, 1e-9)
            part = jnp.clip(approach, 0.0, 1.0)
            near_x, near_y = x + part * dx, y + part * dy
            lost = near_x * near_x + near_y * near_y < below2
            bits |= jnp.where(lost, jnp.uint32(1 << number), jnp.uint32(0))
            x, y = x_after, y_after
        return bits

    def level_with(other_height: Array) -> Bits:
        """The intervals in which there is no vertical separation, `[levels, chosen]`."""
        bits = jnp.zeros(height.shape[1:], dtype=jnp.uint32)
        gap = height[0] - other_height[0][None]
        for number in range(INTERVALS):
            after = height[number + 1] - other_height[number + 1][None]
            crosses = (gap > 0.0) != (after > 0.0)
            lost = crosses | (jnp.minimum(jnp.abs(gap), jnp.abs(after)) < limit)
            bits |= jnp.where(lost, jnp.uint32(1 << number), jnp.uint32(0))
            gap = after
        return bits

    def with_neighbour(bits: Bits, neighbour: Neighbours) -> tuple[Bits, Bits]:
        index, here = neighbour
        rows = subroutine(columns_of, others.table, index)
        other_east, other_north, other_height = jnp.split(rows, 3)
        present = jnp.where(here, others.there[index], jnp.uint32(0))
        near = subroutine(close, path.east_nm, path.north_nm, other_east, other_north)
        lateral = near & there & present[None]
        vertical = subroutine(level_with, other_height)
        lost = lateral & vertical[:1]
        if all_ways:
            lost = jnp.concatenate([lost, lateral[:1] & vertical[1:], lateral[1:2] & vertical[1:2]])
        return bits | lost, lost[0]

    ways = len(there) + height.shape[1] if all_ways else 1
    nothing = jnp.zeros((ways, chosen), dtype=jnp.uint32)
    bits, each = jax.lax.scan(with_neighbour, nothing, neighbours)
    bits = jnp.where(traffic.active, bits, jnp.uint32(0))
    return _first(bits), _first(each)


def _before(until_s: Array) -> Bits:
    """The intervals that begin before a time."""
    bits = jnp.zeros(until_s.shape, dtype=jnp.uint32)
    for number in range(INTERVALS):
        begins = until_s > TIMES_S[number]
        bits |= jnp.where(begins, jnp.uint32(1 << number), jnp.uint32(0))
    return bits


def _first(bits: Bits) -> Float[Array, "..."]:
    """The time at which the first interval of a set begins."""
    zeros = jax.lax.population_count((bits & -bits) - jnp.uint32(1))
    times = jnp.asarray((*TIMES_S[:-1], HORIZON_S), dtype=jnp.float32)
    return times[jnp.minimum(zeros, jnp.uint32(INTERVALS)).astype(jnp.int32)]
