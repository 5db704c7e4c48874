"""The flight times of a sector's routes in cycles, compared with a scenario's time limit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from skystack.airspace.landing import LANDING_NM
from skystack.simulator.simulator import CYCLE_S, Simulator


class FlightTimes(NamedTuple):
    """The cycles that each route takes from its start to its exit, in level flight."""

    fastest: Int[np.ndarray, " routes"]
    """The cycles at `fastest_kt`."""
    slowest: Int[np.ndarray, " routes"]
    """The cycles at `slowest_kt`."""
    fastest_kt: float
    """The highest level speed of any type at any level."""
    slowest_kt: float
    """The lowest level speed of any type at any level."""

    @property
    def shortest(self) -> int:
        """Index of the route that takes the fewest cycles."""
        return int(np.argmin(self.fastest))

    def beyond(self, cycles: int) -> str | None:
        """A notice about the routes that the slowest aircraft cannot fly in `cycles`, or None."""
        too_long = self.slowest[self.slowest > cycles]
        if not too_long.size:
            return None
        least, most = int(too_long.min()), int(too_long.max())
        span = f"{least} to {most}" if least < most else f"{most}"
        return (
            f"{too_long.size} of {self.slowest.size} routes take more than {cycles} cycles: {span} "
            f"at {self.slowest_kt:.0f} kt (see --cycles)"
        )


def flight_times(simulator: Simulator, levels_fl: tuple[int, ...], disc_nm: float) -> FlightTimes:
    """Flight times from the near side of the disc around the first fix to the exit.

    `disc_nm` is the radius of the disc. Routes are flown along geodesic legs, and speeds are the
    level speeds of all types at all levels.
    """
    speed_kt = simulator.performance.cruise_kt(np.array(levels_fl, dtype=np.float64))
    table = simulator.sector.route_table
    leg = np.arange(table.leg_nm.shape[1])
    to_exit_nm = np.where(leg < table.exit_fix[:, None], table.leg_nm, 0.0).sum(axis=1)
    before_nm = np.where(table.lands, LANDING_NM, simulator.sector.exit_before_nm)
    shorter_nm = disc_nm + before_nm
    distance_nm = np.maximum(to_exit_nm.astype(np.float64) - shorter_nm, 0.0)

    def cycles(kt: float) -> Int[np.ndarray, " routes"]:
        return np.maximum(np.ceil(distance_nm / (kt * CYCLE_S / 3600.0)), 1.0).astype(np.int64)

    fastest_kt, slowest_kt = float(speed_kt.max()), float(speed_kt.min())
    return FlightTimes(cycles(fastest_kt), cycles(slowest_kt), fastest_kt, slowest_kt)
