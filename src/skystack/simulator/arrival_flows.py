"""Flows of arriving flights: constant rates, and BluebirdDT's Flight School traffic.

Flights start behind the first fix of a random route, displaced to a random side, or at the fix if
it is inside the area. They are on the heading of the first leg and not on own navigation. Their
entry and exit levels are independent and uniform over the sector's levels that are multiples of
ten, and their airspeeds uniform over a range.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.geometry import direction
from skystack.errors import InputError
from skystack.simulator.arrivals import FREE, Admission, Arrivals, Candidates, Clock, enter, fly
from skystack.simulator.simulator import CYCLE_S, Simulator
from skystack.simulator.traffic import Traffic, start, ticks

HOUR_S = 3600
HOUR_CYCLES = HOUR_S // CYCLE_S
MAX_FLIGHTS_PER_HOUR = 1000.0


def _as_in_bluebird(
    rate_per_s: float, increase_per_s: float, interval_s: float, max_rate_per_s: float
) -> Clock:
    return Clock(
        rate_per_s,
        increase_per_s,
        interval_s,
        max_rate_per_s,
        until_s=float(HOUR_S),
        quadratic=True,
        unchecked_twins=True,
        unchecked_clearances=True,
        held_cycles=2,
    )


FLIGHT_SCHOOL = {
    "category": _as_in_bluebird(0.005, 0.005, 30.0, 0.1),
    "notebook": _as_in_bluebird(0.01, 0.0, 60.0, 0.1),
    "environment": _as_in_bluebird(0.002, 0.002, 60.0, 0.03),
}
"""The clocks of BluebirdDT's three kinds of Flight School traffic, by name.

`category` is `Simulator.from_category("Flight School")`, `notebook` the `InfiniteEnv` of the public
challenge's notebook, and `environment` the `FlightSchoolEnv`."""
MAX_SIDE_NM = 10.0
"""The maximum distance of a birth from the centreline: half the width of an airway in X-Plus."""
STARTERS = 2
"""The number of Flight School flights that start abeam their first fixes."""


def constant_rate(flights_per_hour: float) -> Clock:
    """A clock with a constant rate of births. Raises InputError for an impossible rate."""
    if not 0.0 < flights_per_hour <= MAX_FLIGHTS_PER_HOUR:
        raise InputError(
            f"flights per hour is {flights_per_hour} (allowed: above 0, at most "
            f"{MAX_FLIGHTS_PER_HOUR:g})"
        )
    return Clock(flights_per_hour / HOUR_S)


@dataclass(frozen=True)
class Flow:
    """Draws the arrivals of a scenario."""

    simulator: Simulator
    clock: Clock
    slots: int = 128
    cycles: int = HOUR_CYCLES
    candidates: int = 1024
    """The number of flights drawn at reset; they are used again if there are too few."""
    starters: int = 0
    behind_nm: float = 10.0
    """Distance of a birth behind the first fix."""
    speeds_kt: tuple[float, float] = (350.0, 450.0)
    """Range of airspeeds; the performance model's is multiplied accordingly."""
    speed_spread: float = 0.0
    """Airspeeds are multiplied by a random factor within 1 plus or minus this."""
    climb_spread: float = 0.0
    """The same for the rates of climb and descent."""
    rate_factors: tuple[float, float] = (1.0, 1.0)
    """In each scenario, the clock's rate at the start is multiplied by a random factor in this
    range."""

    @property
    def callsigns(self) -> tuple[str, ...]:
        """The callsigns of the candidates, if they have their own."""
        return ()

    def without_starters(self) -> "Flow":
        """The same arrivals, without flights at the start."""
        return replace(self, starters=0)

    def fly(self, arrivals: Arrivals, traffic: Traffic) -> tuple[Arrivals, Traffic]:
        """Fly one cycle."""
        return fly(self.simulator, arrivals, traffic)

    @cached_property
    def admission(self) -> Admission:
        return Admission(self.simulator, self.clock)

    def draw(self, key: PRNGKeyArray) -> tuple[Arrivals, Traffic]:
        """The arrivals and the traffic at cycle 0."""
        candidate_key, starter_key, clock_key = jax.random.split(key, 3)
        zero = jnp.zeros((), dtype=jnp.int32)
        nobody, level = jnp.zeros(self.slots, dtype=jnp.int32), jnp.zeros(self.slots)
        arrivals = Arrivals(
            flight=nobody + FREE,
            candidate=nobody + FREE,
            entry_level_ticks=level,
            exit_level_ticks=level,
            held=nobody,
            candidates=self._candidates(candidate_key),
            # At least an hour's worth, so that a shorter time needs no other program.
            uniforms=jax.random.uniform(clock_key, (max(self.cycles, HOUR_CYCLES),)),
            used=zero,
            born=zero,
            waiting=zero,
            refused=zero,
            rate_per_s=self.clock.rate_per_s * self._rate_factor(key),
            last_birth_s=jnp.zeros((), dtype=jnp.float32),
            cycle=zero,
        )
        if not self.starters:
            return arrivals, self.empty()
        return self._with_starters(arrivals, self.empty(), starter_key)

    def _rate_factor(self, key: PRNGKeyArray) -> Float[Array, ""]:
        low, high = self.rate_factors
        if low == high:
            return jnp.full((), low, dtype=jnp.float32)
        return jax.random.uniform(jax.random.fold_in(key, 1), minval=low, maxval=high)

    def empty(self) -> Traffic:
        """Traffic without any flight."""
        zero, number = jnp.zeros(self.slots), jnp.zeros(self.slots, dtype=jnp.int32)
        nobody = jnp.zeros(self.slots, dtype=bool)
        traffic = start(jnp.zeros((self.slots, 2)), zero, zero, number, zero, nobody)
        return traffic._replace(
            active=nobody, cleared_fix=number, airspeed_factor=zero + 1.0, climb_factor=zero + 1.0
        )

    def _candidates(self, key: PRNGKeyArray) -> Candidates:
        """Flights behind the first fixes of random routes."""
        key, route_key = jax.random.split(key)
        routes = self.simulator.sector.route_table.last_fix.shape[0]
        route = jax.random.randint(route_key, (self.candidates,), 0, routes, dtype=jnp.int32)
        return self._flights(key, route, self.behind_nm)

    def _flights(self, key: PRNGKeyArray, route: Int[Array, " n"], behind_nm: float) -> Candidates:
        """Flights behind the first fix of each route."""
        sector, count = self.simulator.sector, route.shape
        side_key, entry_key, exit_key, speed_key, error_key, climb_key = jax.random.split(key, 6)
        heading = jnp.asarray(sector.route_table.first_heading_deg)[route]
        half_width = jnp.asarray(self._half_width_nm)[route]
        side = jax.random.uniform(side_key, count, minval=-1.0, maxval=1.0) * half_width
        behind = jnp.asarray(np.where(self._departs, 0.0, behind_nm))[route]
        fix = jnp.asarray(sector.route_table.fixes_nm)[route, 0]
        offset = side[:, None] * direction(heading + 90.0)
        offset -= behind[:, None] * direction(heading)
        lowest, highest = sector.levels_fl
        levels = jnp.asarray([ticks(float(fl)) for fl in range(lowest, highest + 1, 10)])
        low_kt, high_kt = self.speeds_kt
        speed = jax.random.uniform(speed_key, count, minval=low_kt, maxval=high_kt)
        spread = self.speed_spread * jax.random.uniform(error_key, count, minval=-1.0)
        climb = self.climb_spread * jax.random.uniform(climb_key, count, minval=-1.0)
        entry = jax.random.choice(entry_key, levels, count)
        return Candidates(
            due_s=jnp.zeros(count),
            route=route,
            position_nm=fix + offset * sector.plane.scale(fix[:, 1])[:, None],
            heading_deg=heading,
            entry_level_ticks=entry,
            exit_level_ticks=jax.random.choice(exit_key, levels, count),
            airspeed_factor=speed * (1.0 + spread) / self.simulator.level_ground_speed_kt(entry),
            climb_factor=1.0 + climb,
        )

    @cached_property
    def _half_width_nm(self) -> Float[np.ndarray, " routes"]:
        """Half the length of the edge nearest to the first fix of each route; 0 for departures.

        It is at most `MAX_SIDE_NM`, because edges of large sectors are not airways.
        """
        sector = self.simulator.sector
        edges = [sector.edge_through(route[0]) for route in sector.routes]
        length_nm = [
            float(np.hypot(*(edge[-1] - edge[0])) / sector.plane.scale(edge[:1, 1])[0])
            for edge in edges
        ]
        half_nm = np.minimum(np.array(length_nm) / 2.0, MAX_SIDE_NM)
        return np.where(self._departs, 0.0, half_nm).astype(np.float32)

    @cached_property
    def _departs(self) -> Bool[np.ndarray, " routes"]:
        """Whether each route starts at an airport inside the area."""
        sector = self.simulator.sector
        return np.array([sector.departs(route) for route in sector.routes])

    def _with_starters(
        self, arrivals: Arrivals, traffic: Traffic, key: PRNGKeyArray
    ) -> tuple[Arrivals, Traffic]:
        """Add the flights at the start, on different first fixes, one second behind each other."""
        sector = self.simulator.sector
        fixes = sorted({route[0] for route in sector.routes})
        start_of = jnp.asarray([fixes.index(route[0]) for route in sector.routes])
        order_key, route_key, key = jax.random.split(key, 3)
        first = jax.random.permutation(order_key, len(fixes))[: self.starters]
        uniform = jax.random.uniform(route_key, (self.starters, len(sector.routes)))
        mine = start_of[None] == first[:, None]
        route = jnp.argmax(jnp.where(mine, uniform, -1.0), axis=1).astype(jnp.int32)
        flights = self._flights(key, route, 0.0)
        # The second flight starts one second later.
        late_nm = (
            jnp.arange(self.starters, dtype=jnp.float32)
            * flights.airspeed_factor
            * (self.simulator.level_ground_speed_kt(flights.entry_level_ticks) / HOUR_S)
        )
        late = late_nm * sector.plane.scale(flights.position_nm[:, 1])
        flights = flights._replace(
            position_nm=flights.position_nm - late[:, None] * direction(flights.heading_deg)
        )
        for number in range(self.starters):
            here = jnp.arange(self.slots) == number
            flight: Candidates = jax.tree.map(lambda values, n=number: values[n], flights)
            arrivals, traffic = enter(self.simulator, arrivals, traffic, here, flight)
        return arrivals, traffic
