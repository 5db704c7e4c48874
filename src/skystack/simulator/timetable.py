"""Arrivals from a timetable: each listed flight is born at a fixed time."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray
from numpy.typing import ArrayLike

from skystack.simulator.arrival_flows import Flow
from skystack.simulator.arrivals import Arrivals, Candidates, enter
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import Traffic, ticks


class ListedFlight(NamedTuple):
    """A flight of a timetable. Levels are flight levels."""

    callsign: str
    kind: int
    """Index of its type in those of the performance model."""
    route: tuple[str, ...]
    birth_cycle: int
    """The number of cycles after which it is there; 0 for a flight that is there at the start."""
    contact_s: float
    """The time from which it hears clearances."""
    lat: float
    lon: float
    heading_deg: float
    fl: float
    cleared_fl: float
    exit_fl: float
    own_navigation: bool


@dataclass(frozen=True)
class TimetableFlow(Flow):
    """Arrivals of listed flights, in order of birth. Its `clock` must be `recorded`."""

    flights: tuple[ListedFlight, ...] = ()
    starts: bool = True
    """Whether flights with birth cycle 0 are there at the start."""

    @property
    def callsigns(self) -> tuple[str, ...]:
        return tuple(each.callsign for each in self.flights)

    def without_starters(self) -> "TimetableFlow":
        return replace(self, starts=False)

    def draw(self, key: PRNGKeyArray) -> tuple[Arrivals, Traffic]:
        """The arrivals and the traffic at cycle 0, which are the same for every key."""
        arrivals, traffic = super().draw(key)
        arrivals = arrivals._replace(contact_s=jnp.zeros(self.slots))
        starters = sum(each.birth_cycle == 0 for each in self.flights) if self.starts else 0
        for number in range(starters):
            here = jnp.arange(self.slots) == number
            flight: Candidates = jax.tree.map(
                lambda values, number=number: values[number], arrivals.candidates
            )
            arrivals, traffic = enter(self.simulator, arrivals, traffic, here, flight)
            arrivals = arrivals._replace(candidate=jnp.where(here, number, arrivals.candidate))
        return _make_contact(arrivals._replace(used=arrivals.used + starters), traffic)

    def fly(self, arrivals: Arrivals, traffic: Traffic) -> tuple[Arrivals, Traffic]:
        """Fly one cycle. Flights that come into contact then leave their own navigation."""
        return _make_contact(*super().fly(arrivals, traffic))

    def _candidates(self, key: PRNGKeyArray) -> Candidates:
        sector, flights = self.simulator.sector, self.flights
        position = sector.plane.to_plane(
            [each.lat for each in flights], [each.lon for each in flights]
        )

        def column(values: ArrayLike) -> Array:
            return jnp.asarray(np.array(values), dtype=jnp.float32)

        # A newborn is admitted one cycle early, because it is held for that cycle.
        due_s = [CYCLE_S * (each.birth_cycle - 1) for each in flights]
        return Candidates(
            due_s=column(due_s),
            route=jnp.array([sector.route_index(each.route) for each in flights], dtype=jnp.int32),
            position_nm=column(position),
            heading_deg=column([each.heading_deg for each in flights]),
            entry_level_ticks=column([ticks(each.fl) for each in flights]),
            exit_level_ticks=column([ticks(each.exit_fl) for each in flights]),
            airspeed_factor=jnp.ones(len(flights)),
            climb_factor=jnp.ones(len(flights)),
            kind=jnp.array([each.kind for each in flights], dtype=jnp.int32),
            cleared_level_ticks=column([ticks(each.cleared_fl) for each in flights]),
            own_navigation=jnp.array([each.own_navigation for each in flights]),
            contact_s=column([each.contact_s for each in flights]),
        )


def _make_contact(arrivals: Arrivals, traffic: Traffic) -> tuple[Arrivals, Traffic]:
    """End the own navigation of flights that have come into contact in the last cycle.

    As in BluebirdDT's Springfield, they hold their headings until they are instructed.
    """
    assert arrivals.contact_s is not None, "arrivals have no times of contact"
    since_s = arrivals.time_s - arrivals.contact_s
    ended = (since_s >= 0.0) & (since_s < CYCLE_S) & traffic.own_navigation
    heading = jnp.where(ended, traffic.flown_heading_deg, traffic.cleared_heading_deg)
    return arrivals, traffic._replace(
        own_navigation=traffic.own_navigation & ~ended, cleared_heading_deg=heading
    )
