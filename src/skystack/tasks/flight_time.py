"""How many cycles a sector's routes take, and whether an experiment's cycles allow them."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S, Simulator


class FlightTimes(NamedTuple):
    """The least cycles in which each route can be flown."""

    cycles: Int[np.ndarray, " routes"]
    speed_kt: float
    """The fastest ground speed there is."""

    @property
    def shortest(self) -> int:
        """Index of the route that takes the fewest."""
        return int(np.argmin(self.cycles))


def flight_times(simulator: Simulator, levels_fl: tuple[int, ...], disc_nm: float) -> FlightTimes:
    """Times from the near side of the disc round the first fix to the exit, along the geodesics.

    At the speed of the fastest type in level flight at the fastest of the levels.
    """
    kinds = jnp.arange(len(simulator.performance.types), dtype=jnp.int32)
    speed_kt = max(
        float(jnp.max(simulator.level_ground_speed_kt(jnp.full(len(kinds), level), kinds)))
        for level in (fl * TICKS_PER_FL for fl in levels_fl)
    )
    table = simulator.sector.route_table
    leg = np.arange(table.leg_nm.shape[1])
    to_exit_nm = np.where(leg < table.last_fix[:, None] - 1, table.leg_nm, 0.0).sum(axis=1)
    way_nm = np.maximum(to_exit_nm.astype(np.float64) - disc_nm, 0.0)
    cycles = np.ceil(way_nm / (speed_kt * CYCLE_S / 3600.0)).astype(np.int64)
    return FlightTimes(np.maximum(cycles, 1), speed_kt)
