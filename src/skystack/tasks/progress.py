"""The progress of each aircraft: fixes passed, entry, exit, excursion."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from skystack.airspace.geometry import (
    crosses_outward,
    distance_right_of_route,
    dot,
    inside_area,
    point_of,
    points_of,
    value_of,
)
from skystack.airspace.sector import Sector
from skystack.compilation.subroutine import subroutine
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.centreline import distance_from_route

PASSED_NM = 1.0
"""A fix counts as passed within this distance."""
MAX_UNROLLED = 16
"""Routes with at most this many fixes are unrolled in compiled programs; longer ones use a loop."""


class FlightPlan(NamedTuple):
    """The entry and exit level of each aircraft in ticks. Constant during a scenario."""

    entry_level_ticks: Float[Array, "aircraft *batch"]
    exit_level_ticks: Float[Array, "aircraft *batch"]


class Progress(NamedTuple):
    """The progress of each aircraft of a scenario."""

    previous_nm: Float[Array, "aircraft 2 *batch"]
    """The position one cycle ago."""
    previous_level_ticks: Float[Array, "aircraft *batch"]
    """The level one cycle ago."""
    next_fix: Int[Array, "aircraft *batch"]
    """Index of the next fix in the route. At least 1; never decreases; stays at the last fix."""
    entered: Bool[Array, "aircraft *batch"]
    excursion: Bool[Array, "aircraft *batch"]
    exited: Bool[Array, "aircraft *batch"]
    exited_correctly: Bool[Array, "aircraft *batch"]
    """Whether it left through its exit and at its exit level."""
    cycles: Float[Array, "*batch"]
    """The number of cycles flown."""


@dataclass(frozen=True)
class ProgressTracker:
    """Updates the progress of aircraft in one sector."""

    sector: Sector
    airway_nm: float | None = None
    """The distance from the centreline beyond which an aircraft has made an excursion."""

    def begin(self, traffic: Traffic) -> Progress:
        """The progress at cycle 0."""
        none = jnp.zeros_like(traffic.active)
        return Progress(
            previous_nm=traffic.position_nm,
            previous_level_ticks=traffic.level_ticks,
            next_fix=traffic.next_fix,
            entered=self._inside(traffic),
            excursion=none,
            exited=none,
            exited_correctly=none,
            cycles=jnp.zeros(traffic.level_ticks.shape[1:], dtype=jnp.float32),
        )

    def update(self, progress: Progress, plan: FlightPlan, traffic: Traffic) -> Progress:
        """The progress after a cycle. `traffic.active` is still as it was before the cycle."""
        inside = subroutine(self._inside, traffic)
        exits = (
            traffic.active & progress.entered & subroutine(self._crosses_exit, progress, traffic)
        )
        at_exit_level = traffic.level_ticks == plan.exit_level_ticks
        excursions = traffic.active & progress.entered & ~inside & ~exits
        if self.airway_nm is not None:
            off_airway = jnp.abs(distance_from_route(self.sector, traffic)) > self.airway_nm
            excursions |= traffic.active & progress.entered & off_airway
        return Progress(
            previous_nm=traffic.position_nm,
            previous_level_ticks=traffic.level_ticks,
            next_fix=subroutine(self._next_fix, traffic, progress.next_fix),
            entered=progress.entered | (traffic.active & inside),
            excursion=progress.excursion | excursions,
            exited=progress.exited | exits,
            exited_correctly=progress.exited_correctly | (exits & at_exit_level),
            cycles=progress.cycles + 1.0,
        )

    def close(self, progress: Progress, ended: Bool[Array, "*batch"]) -> Progress:
        """The progress, with excursions where a scenario ended before an aircraft entered."""
        return progress._replace(excursion=progress.excursion | (ended[None] & ~progress.entered))

    def _inside(self, traffic: Traffic) -> Bool[Array, "aircraft *batch"]:
        lowest, highest = (ticks(fl) for fl in self.sector.levels_fl)
        within_levels = (traffic.level_ticks >= lowest) & (traffic.level_ticks <= highest)
        return within_levels & inside_area(traffic.position_nm, self.sector.area_nm)

    def _crosses_exit(self, progress: Progress, traffic: Traffic) -> Bool[Array, "aircraft *batch"]:
        crossed = jnp.zeros_like(traffic.active)
        for edge in pairwise(points_of(self.sector.route_table.exit_edge_nm, traffic.route)):
            crossed |= crosses_outward(progress.previous_nm, traffic.position_nm, *edge)
        return crossed

    def _next_fix(
        self, traffic: Traffic, next_fix: Int[Array, "aircraft *batch"]
    ) -> Int[Array, "aircraft *batch"]:
        """The first fix from `next_fix` on that has not been passed.

        A fix is passed within `PASSED_NM`, or beyond the bisector of its two legs. At a turn of
        more than 90 degrees the bisector also crosses the leg to the fix; there the aircraft must
        also be nearer to the next leg.
        """
        table = self.sector.route_table
        near_nm = PASSED_NM * self.sector.plane.scale(traffic.position_nm[:, 1])
        last = value_of(table.last_fix, traffic.route)
        longest = table.fixes_nm.shape[1]
        if longest > MAX_UNROLLED:  # unrolling would take minutes to compile

            def passed(found: Int[Array, "aircraft *batch"]) -> Bool[Array, "aircraft *batch"]:
                return (found < last) & self._passed(traffic, near_nm, found)

            found: Int[Array, "aircraft *batch"] = jax.lax.while_loop(
                lambda found: jnp.any(passed(found)),
                lambda found: found + passed(found).astype(found.dtype),
                next_fix,
            )
            return found
        found = last
        for index in reversed(range(longest)):
            passed_fix = self._passed(traffic, near_nm, index)
            is_ahead = (index >= next_fix) & (index < last) & ~passed_fix
            found = jnp.where(is_ahead, index, found)
        return found

    def _passed(
        self,
        traffic: Traffic,
        near_nm: Float[Array, "aircraft *batch"],
        index: int | Int[Array, "aircraft *batch"],
    ) -> Bool[Array, "aircraft *batch"]:
        """Whether each aircraft has passed a fix of its route."""
        table = self.sector.route_table

        def fix(index: int | Int[Array, "aircraft *batch"]) -> Float[Array, "aircraft 2 *batch"]:
            return _of_route(table.fixes_nm, traffic.route, index)

        offset = traffic.position_nm - fix(index)
        past = dot(offset, _of_route(table.bisector, traffic.route, index)) > 0.0
        sharp = table.sharp[:, index] if isinstance(index, int) else table.sharp
        if sharp.any():
            before, after = (
                jnp.abs(distance_right_of_route(traffic.position_nm, (fix(first), fix(first + 1))))
                for first in (index - 1, index)
            )
            past &= (after < before) | ~_of_route(table.sharp, traffic.route, index)
        return past | (dot(offset, offset) < near_nm**2)


def _of_route(
    values: Shaped[np.ndarray, "routes fixes *vector"],
    route: Int[Array, "aircraft *batch"],
    fix: int | Int[Array, "aircraft *batch"],
) -> Array:
    """The table's entry for a fix of each aircraft's route."""
    look_up = value_of if values.ndim == 2 else point_of
    if isinstance(fix, int):
        return look_up(values[:, fix], route)
    fixes = values.shape[1]
    index = route * fixes + jnp.clip(fix, 0, fixes - 1)
    return look_up(values.reshape(-1, *values.shape[2:]), index)
