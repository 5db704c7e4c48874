"""Random scenarios for the paper's tasks."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from skystack.airspace.geometry import direction
from skystack.simulator.entries import draw_kinds, draw_levels, draw_routes_apart
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic, start, ticks


class Drawn(NamedTuple):
    """A random scenario at cycle 0."""

    traffic: Traffic
    exit_level_ticks: Float[Array, " aircraft"]
    """The exit level of each aircraft, in ticks."""


@runtime_checkable
class Scenarios(Protocol):
    """A source of random scenarios for a task."""

    @property
    def aircraft(self) -> int: ...

    def draw(self, key: PRNGKeyArray) -> Drawn: ...


@dataclass(frozen=True)
class LateralScenarios:
    """Scenarios as in the paper's table "Aircraft parameters for lateral control scenarios".

    Each aircraft gets a random route, with no two routes sharing a first fix; a position uniform in
    a disc around that fix; the geodesic heading of the first leg; and a level, which is also its
    exit level. If there are several levels or types (not in the paper), each aircraft draws one.
    """

    simulator: Simulator
    aircraft: int = 2
    levels_fl: tuple[int, ...] = (300,)
    disc_nm: float = 4.0
    shares: tuple[float, ...] = (1.0,)
    """Relative frequency of each type of the performance model."""

    def draw(self, key: PRNGKeyArray) -> Drawn:
        table = self.simulator.sector.route_table
        route_key, radius_key, angle_key = jax.random.split(key, 3)
        route = draw_routes_apart(route_key, self.simulator.sector, self.aircraft)
        first_fix = jnp.asarray(table.fixes_nm)[route, 0]
        radius = self.disc_nm * jnp.sqrt(jax.random.uniform(radius_key, (self.aircraft,)))
        radius *= self.simulator.sector.plane.scale(first_fix[:, 1])
        angle = jax.random.uniform(angle_key, (self.aircraft,), maxval=360.0)
        level_ticks = draw_levels(key, self.levels_fl, self.aircraft)
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


@dataclass(frozen=True)
class VerticalScenarios:
    """Scenarios as in the paper's table "Aircraft parameters for vertical control scenarios".

    One aircraft at the first fix of a random route, on own navigation. Its entry and exit levels
    are drawn independently and uniformly from the sector's levels that are multiples of 10.
    """

    simulator: Simulator
    shares: tuple[float, ...] = (1.0,)
    """Relative frequency of each type of the performance model."""

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
