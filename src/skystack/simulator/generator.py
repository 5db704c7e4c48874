"""Random scenarios: the paper's tables of aircraft parameters."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, PRNGKeyArray

from skystack.airspace.geometry import direction
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic, start, ticks


@dataclass(frozen=True)
class LateralScenarios:
    """Table "Aircraft parameters for lateral control scenarios".

    Every aircraft gets a random route with a first fix of its own, a position uniform in a disc
    round that fix, the geodesic heading of the first leg, and the one level.
    """

    simulator: Simulator
    aircraft: int = 2
    level_fl: int = 300
    disc_nm: float = 4.0

    def draw(self, key: PRNGKeyArray) -> Traffic:
        """One scenario's traffic at cycle 0."""
        table = self.simulator.sector.route_table
        route_key, radius_key, angle_key = jax.random.split(key, 3)
        route = self._draw_routes(route_key)
        radius = self.disc_nm * jnp.sqrt(jax.random.uniform(radius_key, (self.aircraft,)))
        angle = jax.random.uniform(angle_key, (self.aircraft,), maxval=360.0)
        level = jnp.full(self.aircraft, ticks(self.level_fl), dtype=jnp.float32)
        return start(
            position_nm=jnp.asarray(table.fixes_nm)[route, 0] + radius[:, None] * direction(angle),
            heading_deg=jnp.asarray(table.first_heading_deg)[route],
            level=level,
            route=route,
            ground_speed_kt=self.simulator.level_ground_speed_kt(level),
            own_navigation=jnp.zeros(self.aircraft, dtype=bool),
        )

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


def first_fixes(simulator: Simulator) -> int:
    """How many different first fixes the sector's routes have: the most aircraft of a scenario."""
    return len({route[0] for route in simulator.sector.routes})
