"""How many cycles a sector's routes take, and which take more than a scenario lasts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from skystack.simulator.simulator import CYCLE_S, Simulator


class FlightTimes(NamedTuple):
    """The cycles that each route takes from its start to its exit, in level flight."""

    fastest: Int[np.ndarray, " routes"]
    """At `fastest_kt`, the highest speed of any type at any level."""
    slowest: Int[np.ndarray, " routes"]
    """At `slowest_kt`, the lowest."""
    fastest_kt: float
    slowest_kt: float

    @property
    def shortest(self) -> int:
        """Index of the route that takes the fewest."""
        return int(np.argmin(self.fastest))

    def beyond(self, cycles: int) -> str | None:
        """A line on the routes that some aircraft cannot fly in so many cycles, if any."""
        late = self.slowest[self.slowest > cycles]
        if not late.size:
            return None
        least, most = int(late.min()), int(late.max())
        span = f"{least} to {most}" if least < most else f"{most}"
        return (
            f"{late.size} of {self.slowest.size} routes take more than {cycles} cycles: {span} at "
            f"{self.slowest_kt:.0f} kt (see --cycles)"
        )


def flight_times(simulator: Simulator, levels_fl: tuple[int, ...], disc_nm: float) -> FlightTimes:
    """Times from the near side of the disc [NM] round the first fix to the exit fix.

    Along geodesic legs, at the level speeds of all types at all of the levels.
    """
    speed_kt = simulator.performance.cruise_kt(np.array(levels_fl, dtype=np.float64))
    table = simulator.sector.route_table
    leg = np.arange(table.leg_nm.shape[1])
    to_exit_nm = np.where(leg < table.last_fix[:, None] - 1, table.leg_nm, 0.0).sum(axis=1)
    way_nm = np.maximum(to_exit_nm.astype(np.float64) - disc_nm, 0.0)

    def cycles(kt: float) -> Int[np.ndarray, " routes"]:
        return np.maximum(np.ceil(way_nm / (kt * CYCLE_S / 3600.0)), 1.0).astype(np.int64)

    fastest_kt, slowest_kt = float(speed_kt.max()), float(speed_kt.min())
    return FlightTimes(cycles(fastest_kt), cycles(slowest_kt), fastest_kt, slowest_kt)
