"""Random scenarios: the paper's tables of aircraft parameters."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.geometry import bearing, direction, value_of, wrap_360
from skystack.simulator.own_navigation import fix_of
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic, start, ticks


class Drawn(NamedTuple):
    """A random scenario at cycle 0."""

    traffic: Traffic
    exit_level_ticks: Float[Array, " aircraft"]
    """At which each aircraft is to leave, in ticks."""


@runtime_checkable
class Scenarios(Protocol):
    """What draws the scenarios of a task."""

    @property
    def aircraft(self) -> int: ...

    def draw(self, key: PRNGKeyArray) -> Drawn: ...


@dataclass(frozen=True)
class LateralScenarios:
    """Table "Aircraft parameters for lateral control scenarios".

    Every aircraft gets a random route with a first fix of its own, a position uniform in a disc
    round that fix, the geodesic heading of the first leg, and the one level, at which it leaves.
    With several levels or several types of aircraft (not in the paper), each gets one of them.
    """

    simulator: Simulator
    aircraft: int = 2
    levels_fl: tuple[int, ...] = (300,)
    disc_nm: float = 4.0
    shares: tuple[float, ...] = (1.0,)
    """How often each type of the performance model comes."""

    def draw(self, key: PRNGKeyArray) -> Drawn:
        table = self.simulator.sector.route_table
        route_key, radius_key, angle_key = jax.random.split(key, 3)
        route = self._draw_routes(route_key)
        first_fix = jnp.asarray(table.fixes_nm)[route, 0]
        radius = self.disc_nm * jnp.sqrt(jax.random.uniform(radius_key, (self.aircraft,)))
        radius *= self.simulator.sector.plane.scale(first_fix[:, 1])
        angle = jax.random.uniform(angle_key, (self.aircraft,), maxval=360.0)
        level_ticks = self._draw_levels(key)
        kind = draw_kinds(key, self.shares, self.aircraft)
        traffic = start(
            position_nm=first_fix + radius[:, None] * direction(angle),
            heading_deg=jnp.asarray(table.first_heading_deg)[route],
            level_ticks=level_ticks,
            route=route,
            ground_speed_kt=self.simulator.level_ground_speed_kt(level_ticks, kind),
            own_navigation=jnp.zeros(self.aircraft, dtype=bool),
            kind=kind,
        )
        return Drawn(traffic, level_ticks)

    def _draw_levels(self, key: PRNGKeyArray) -> Float[Array, " aircraft"]:
        levels = jnp.array([ticks(float(fl)) for fl in self.levels_fl], dtype=jnp.float32)
        if len(self.levels_fl) == 1:
            return jnp.full(self.aircraft, levels[0])
        return jax.random.choice(jax.random.fold_in(key, _LEVELS), levels, (self.aircraft,))

    def _draw_routes(self, key: PRNGKeyArray) -> Int[Array, " aircraft"]:
        """One after another, uniform over the routes whose first fix is still free."""
        shares_start = jnp.asarray(self._shares_start())
        free = jnp.ones(shares_start.shape[0], dtype=bool)
        routes = []
        for lottery in jax.random.uniform(key, (self.aircraft, shares_start.shape[0])):
            routes.append(jnp.argmax(jnp.where(free, lottery, -1.0)).astype(jnp.int32))
            free = free & ~shares_start[routes[-1]]
        return jnp.stack(routes)

    def _shares_start(self) -> Bool[np.ndarray, "routes routes"]:
        first = np.array([route[0] for route in self.simulator.sector.routes])
        return first[:, None] == first[None, :]


@dataclass(frozen=True)
class Crowd:
    """Any number of aircraft, anywhere along the legs of random routes, flying along them.

    Nobody keeps them apart at the start: for measuring, and for tasks with many aircraft.
    """

    simulator: Simulator
    aircraft: int
    level_fl: int = 300

    def draw(self, key: PRNGKeyArray) -> Drawn:
        table = self.simulator.sector.route_table
        count = (self.aircraft,)
        route_key, leg_key, along_key = jax.random.split(key, 3)
        route = jax.random.randint(route_key, count, 0, table.last_fix.shape[0], dtype=jnp.int32)
        # Up to the exit fix, the last but one.
        legs = (value_of(table.last_fix, route) - 1).astype(jnp.float32)
        leg = jnp.floor(jax.random.uniform(leg_key, count) * legs).astype(jnp.int32)
        begin, end = fix_of(table, route, leg), fix_of(table, route, leg + 1)
        level_ticks = jnp.full(count, ticks(self.level_fl), dtype=jnp.float32)
        traffic = start(
            position_nm=begin + jax.random.uniform(along_key, count)[:, None] * (end - begin),
            heading_deg=wrap_360(bearing(end - begin)),
            level_ticks=level_ticks,
            route=route,
            ground_speed_kt=self.simulator.level_ground_speed_kt(level_ticks),
            own_navigation=jnp.zeros(count, dtype=bool),
        )
        return Drawn(traffic._replace(next_fix=leg + 1), level_ticks)


@dataclass(frozen=True)
class VerticalScenarios:
    """Table "Aircraft parameters for vertical control scenarios".

    One aircraft at the first fix of a random route, on own navigation. Its entry and its exit level
    are uniform over the multiples of ten in the sector, and may be the same.
    """

    simulator: Simulator
    shares: tuple[float, ...] = (1.0,)
    """How often each type of the performance model comes."""

    aircraft = 1

    def draw(self, key: PRNGKeyArray) -> Drawn:
        table, (lowest, highest) = (
            self.simulator.sector.route_table,
            self.simulator.sector.levels_fl,
        )
        route_key, entry_key, exit_key = jax.random.split(key, 3)
        route = jax.random.randint(route_key, (1,), 0, table.last_fix.shape[0], dtype=jnp.int32)
        levels = jnp.asarray([ticks(float(fl)) for fl in range(lowest, highest + 1, 10)])
        entry = jax.random.choice(entry_key, levels, (1,))
        kind = draw_kinds(key, self.shares, 1)
        traffic = start(
            position_nm=jnp.asarray(table.fixes_nm)[route, 0],
            heading_deg=jnp.asarray(table.first_heading_deg)[route],
            level_ticks=entry,
            route=route,
            ground_speed_kt=self.simulator.level_ground_speed_kt(entry, kind),
            own_navigation=jnp.ones(1, dtype=bool),
            kind=kind,
        )
        return Drawn(traffic, jax.random.choice(exit_key, levels, (1,)))


_LEVELS, _KINDS = 1, 2
"""Keys of their own: what the paper draws stays as it is, whatever is drawn beside it."""


def draw_kinds(key: PRNGKeyArray, shares: tuple[float, ...], count: int) -> Int[Array, " {count}"]:
    """A type for each aircraft."""
    if len(shares) == 1:
        return jnp.zeros(count, dtype=jnp.int32)
    weights = jnp.log(jnp.array(shares, dtype=jnp.float32))
    drawn = jax.random.categorical(jax.random.fold_in(key, _KINDS), weights, shape=(count,))
    return drawn.astype(jnp.int32)


def first_fixes(simulator: Simulator) -> int:
    """How many different first fixes the sector's routes have: the most aircraft of a scenario."""
    return len({route[0] for route in simulator.sector.routes})
