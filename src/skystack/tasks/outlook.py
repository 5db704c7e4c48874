"""The outlook of flights: when they would lose separation, as cleared and after other clearances.

Each flight is predicted (`skystack.tasks.prediction`) as cleared and after each of a few other
clearances, `WAYS`. All other flights are predicted as cleared.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.prediction import (
    HORIZON_S,
    TIMES_S,
    PredictedPath,
    Rows,
    path_along_route,
    path_as_cleared,
    path_on_heading,
    predicted_level,
)

TURNS_DEG = (-90.0, -60.0, -40.0, -20.0, -10.0, 10.0, 20.0, 40.0, 60.0, 90.0)
"""Turns from the cleared heading that are tried."""
CHANGES_FL = (-70.0, -40.0, -20.0, -10.0, 10.0, 20.0, 40.0, 70.0)
"""Changes of the cleared level that are tried."""
WAYS = (
    "cleared",
    "direct",
    *(f"turn {turn:+.0f}" for turn in TURNS_DEG),
    "exit level",
    *(f"level {change:+.0f}" for change in CHANGES_FL),
    "direct, exit level",
)
"""The clearances that are tried, each with one change, except the last."""
NEIGHBOURS = 12
"""The number of other flights that are compared with each flight."""
MARGIN_NM = 1.0
"""Added to the separation standard in what a policy observes."""
INTERVALS = len(TIMES_S) - 1
"""At most 32: sets of intervals are stored as bits."""
FAR = 1e6
"""The urgency of a free slot."""

Bits = Any


class Outlook(NamedTuple):
    """What is predicted for each flight. Times are in seconds, at most `HORIZON_S`."""

    time_s: Float[Array, "ways slots *batch"]
    """The time until separation would be lost after each clearance of `WAYS`."""
    neighbour: Int[Array, "neighbours slots *batch"]
    """The slots of the other flights that matter most, the most urgent first."""
    urgency: Float[Array, "neighbours slots *batch"]
    """The lower, the more urgent; `FAR` for free slots."""
    neighbour_time_s: Float[Array, "neighbours slots *batch"]
    """The time until separation from each neighbour would be lost as cleared."""

    @property
    def exists(self) -> Bool[Array, "neighbours slots *batch"]:
        """Whether each neighbour is a flight."""
        return self.urgency < FAR


def look_ahead(
    simulator: Simulator,
    traffic: Traffic,
    next_fix: Int[Array, "slots *batch"],
    exit_level_ticks: Rows,
    margin_nm: float = MARGIN_NM,
) -> Outlook:
    """The outlook of all active flights.

    `next_fix` is that of a clearance direct, and `margin_nm` is added to the separation standard.
    """
    sector = simulator.sector
    # Subroutines, or else each result would be computed again wherever it is used.
    routes = subroutine(partial(_route_paths, sector), traffic, next_fix)
    headings = subroutine(partial(_heading_paths, sector), traffic)
    levels = subroutine(partial(_levels, simulator), traffic, exit_level_ticks)
    neighbour, urgency = subroutine(partial(most_urgent, sector), traffic, routes, exit_level_ticks)
    time_s, neighbour_time_s = subroutine(
        partial(_times_to_loss, sector, margin_nm),
        traffic,
        (routes, headings),
        levels,
        neighbour,
        urgency,
    )
    return Outlook(time_s, neighbour, urgency, neighbour_time_s)


def _route_paths(
    sector: Sector, traffic: Traffic, next_fix: Int[Array, "slots *batch"]
) -> PredictedPath:
    """The paths as cleared and direct, with an axis for the two before that of the slots."""
    cleared = path_as_cleared(sector, traffic)
    direct = path_along_route(sector, traffic, next_fix, jnp.zeros_like(traffic.active))
    return PredictedPath(
        jnp.stack([cleared.east_nm, direct.east_nm], axis=1),
        jnp.stack([cleared.north_nm, direct.north_nm], axis=1),
        jnp.stack([cleared.until_s, direct.until_s]),
    )


def _heading_paths(sector: Sector, traffic: Traffic) -> PredictedPath:
    """The paths after the turns, with an axis for these before that of the slots."""
    turn = jnp.asarray(TURNS_DEG).reshape((-1,) + (1,) * traffic.heading_deg.ndim)
    heading = traffic.cleared_heading_deg[None] + turn
    along = PredictedPath(1, 1, 0)  # type: ignore[arg-type]  # the axes of the turns
    paths: PredictedPath = jax.vmap(partial(path_on_heading, sector, traffic), out_axes=along)(
        heading
    )
    return paths


def _levels(
    simulator: Simulator, traffic: Traffic, exit_level_ticks: Rows
) -> Float[Array, "times levels slots *batch"]:
    """The levels after clearances to levels, in the order of `WAYS`; as cleared first."""
    goals = jnp.stack(_goals(simulator.sector, traffic, exit_level_ticks))
    levels: Array = jax.vmap(partial(predicted_level, simulator, traffic), out_axes=1)(goals)
    return levels


def _goals(sector: Sector, traffic: Traffic, exit_level_ticks: Rows) -> list[Rows]:
    """The cleared level, the exit level, and the changed levels."""
    lowest, highest = (ticks(float(fl)) for fl in sector.levels_fl)
    cleared = traffic.cleared_level_ticks
    changed = [jnp.clip(cleared + ticks(change), lowest, highest) for change in CHANGES_FL]
    return [cleared, exit_level_ticks, *changed]


def most_urgent(
    sector: Sector,
    traffic: Traffic,
    routes: PredictedPath,
    exit_level_ticks: Rows,
) -> tuple[Int[Array, "neighbours slots *batch"], Float[Array, "neighbours slots *batch"]]:
    """For each flight the others that come closest, those at levels that it may use first.

    `routes` are the paths as cleared, first on the second axis.
    """
    slots = traffic.active.shape[0]
    scale = sector.plane.scale(traffic.position_nm[:, 1])
    least = jnp.full((slots, *traffic.active.shape), jnp.inf)
    for index in range(0, len(TIMES_S), 2):
        east, north = routes.east_nm[index, 0], routes.north_nm[index, 0]
        # Later approaches count as more distant: 1 NM a minute.
        late = TIMES_S[index] / 60.0
        squared = (east[:, None] - east[None]) ** 2 + (north[:, None] - north[None]) ** 2
        least = jnp.minimum(least, jnp.sqrt(squared) / scale[:, None] + late)
    level, goal = traffic.level_ticks, traffic.cleared_level_ticks
    low, high = jnp.minimum(level, goal), jnp.maximum(level, goal)
    own_low = jnp.minimum(low, exit_level_ticks) - ticks(20.0)
    own_high = jnp.maximum(high, exit_level_ticks) + ticks(20.0)
    apart = jnp.maximum(low[None] - own_high[:, None], own_low[:, None] - high[None])
    score = least + jnp.maximum(apart, 0.0) / ticks(5.0)
    other = ~jnp.eye(slots, dtype=bool).reshape((slots, slots) + (1,) * (level.ndim - 1))
    score = jnp.where(traffic.active[None] & other, score, FAR)
    count = min(NEIGHBOURS, slots - 1)
    urgency, neighbour = jax.lax.top_k(-jnp.moveaxis(score, 1, -1), count)
    return jnp.moveaxis(neighbour, -1, 0), -jnp.moveaxis(urgency, -1, 0)


def _times_to_loss(
    sector: Sector,
    margin_nm: float,
    traffic: Traffic,
    paths: tuple[PredictedPath, PredictedPath],
    levels: Float[Array, "times levels slots *batch"],
    neighbour: Int[Array, "neighbours slots *batch"],
    urgency: Float[Array, "neighbours slots *batch"],
) -> tuple[Array, Array]:
    """The time to the first loss for each way, and as cleared for each neighbour.

    Losses are stored as sets of intervals between the predicted times, one bit per interval.
    """
    shape = traffic.active.shape
    columns = int(np.prod(shape))
    batch = int(np.prod(shape[1:], dtype=int))
    inverse = (1.0 / sector.plane.scale(traffic.position_nm[:, 1])).reshape(columns)

    def flat(values: Array) -> Array:  # [times, ways, slots, *batch] -> [times, ways, columns]
        return values.reshape(*values.shape[:2], columns)

    tracks = [(flat(path.east_nm), flat(path.north_nm)) for path in paths]
    height = flat(levels)
    there = jnp.concatenate([_before(path.until_s.reshape(-1, columns)) for path in paths])
    column = jnp.arange(columns, dtype=jnp.int32) % batch
    at = neighbour.reshape(-1, columns) * batch + column[None]
    exists = (urgency < FAR).reshape(-1, columns)
    below2 = (sector.separation_nm + margin_nm) ** 2
    limit = ticks(float(sector.separation_fl))
    east, north = tracks[0]
    others = jnp.concatenate([east[:, 0], north[:, 0], height[:, 0]])  # [3 * times, columns]

    def close(east: Array, north: Array, other_east: Array, other_north: Array) -> Bits:
        """The intervals in which each path comes too close, `[laterals, columns]`."""
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
        """The intervals in which there is no vertical separation, `[levels, columns]`."""
        bits = jnp.zeros(height.shape[1:], dtype=jnp.uint32)
        gap = height[0] - other_height[0][None]
        for number in range(INTERVALS):
            after = height[number + 1] - other_height[number + 1][None]
            crosses = (gap > 0.0) != (after > 0.0)
            lost = crosses | (jnp.minimum(jnp.abs(gap), jnp.abs(after)) < limit)
            bits |= jnp.where(lost, jnp.uint32(1 << number), jnp.uint32(0))
            gap = after
        return bits

    def with_neighbour(bits: Bits, xs: tuple[Array, Array]) -> tuple[Bits, Bits]:
        index, here = xs
        other_east, other_north, other_height = jnp.split(subroutine(_columns_of, others, index), 3)
        present = jnp.where(here, there[0][index], jnp.uint32(0))
        near = [subroutine(close, *track, other_east, other_north) for track in tracks]
        lateral = jnp.concatenate(near) & there & present[None]
        vertical = subroutine(level_with, other_height)
        lost = jnp.concatenate(
            [lateral & vertical[:1], lateral[:1] & vertical[1:], lateral[1:2] & vertical[1:2]]
        )
        return bits | lost, lost[0]

    nothing = jnp.zeros((len(WAYS), columns), dtype=jnp.uint32)
    bits, each = jax.lax.scan(with_neighbour, nothing, (at, exists))
    bits = jnp.where(traffic.active.reshape(columns), bits, jnp.uint32(0))
    return _first(bits).reshape(-1, *shape), _first(each).reshape(-1, *shape)


def _columns_of(values: Array, index: Array) -> Array:
    return values[:, index]


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
