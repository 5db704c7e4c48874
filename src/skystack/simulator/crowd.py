"""Random scenarios with many aircraft along the routes, for benchmarks and large tasks."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from skystack.airspace.geometry import bearing, value_of, wrap_360
from skystack.simulator.generator import Drawn
from skystack.simulator.own_navigation import fix_of
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import start, ticks


@dataclass(frozen=True)
class Crowd:
    """Any number of aircraft at random positions on the legs of random routes, flying along them.

    The initial positions are not separated.
    """

    simulator: Simulator
    aircraft: int
    level_fl: int = 300

    def draw(self, key: PRNGKeyArray) -> Drawn:
        table = self.simulator.sector.route_table
        count = (self.aircraft,)
        route_key, leg_key, along_key = jax.random.split(key, 3)
        route = jax.random.randint(route_key, count, 0, table.last_fix.shape[0], dtype=jnp.int32)
        # Only legs before the exit fix.
        legs = value_of(table.exit_fix, route).astype(jnp.float32)
        leg = jnp.floor(jax.random.uniform(leg_key, count) * legs).astype(jnp.int32)
        leg_start, leg_end = fix_of(table, route, leg), fix_of(table, route, leg + 1)
        level_ticks = jnp.full(count, ticks(self.level_fl), dtype=jnp.float32)
        traffic = start(
            position_nm=(
                leg_start + jax.random.uniform(along_key, count)[:, None] * (leg_end - leg_start)
            ),
            heading_deg=wrap_360(bearing(leg_end - leg_start)),
            level_ticks=level_ticks,
            route=route,
            ground_speed_kt=self.simulator.level_ground_speed_kt(level_ticks),
            own_navigation=jnp.zeros(count, dtype=bool),
        )
        return Drawn(traffic._replace(next_fix=leg + 1), level_ticks)
