"""The states that agents see of traffic in another simulator, rebuilt from its reports."""

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from skystack.agents.transmission import Transmission, instruction_of
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.platforms.flight_report import FlightReport
from skystack.platforms.instruction import Instruction
from skystack.simulator.arrivals import Arrivals
from skystack.simulator.simulator import Simulator, turn_to_deg
from skystack.simulator.traffic import NO_TURN, RADIUS_UNKNOWN, Traffic, ticks
from skystack.tasks.sector_world import World


def instructions_of(
    world: World,
    traffic: Traffic,
    slots: Mapping[str, int],
    transmissions: Iterable[Transmission],
) -> list[Instruction]:
    """Transmissions as platforms receive them. `slots` are those of the flights by callsign."""
    callsigns, routes = {slot: callsign for callsign, slot in slots.items()}, world.sector.routes
    return [
        instruction_of(each, callsigns[each.slot], routes[int(traffic.route[each.slot])])
        for each in transmissions
    ]


class ReportedTraffic:
    """Reads reports into the traffic of a world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._routes = {tuple(route): index for index, route in enumerate(world.sector.routes)}

    def read(
        self, traffic: Traffic, slots: Mapping[str, int], reports: Mapping[str, FlightReport]
    ) -> Traffic:
        """The traffic as reported, in numpy arrays, with all clearances adopted.

        `slots` are those of the flights by callsign. Flights without a report do not change.
        """
        values = writable(traffic)
        values["pending_turn"][:] = NO_TURN
        airspeed_kt = np.full_like(traffic.ground_speed_kt, np.nan)
        for callsign, slot in slots.items():
            if callsign in reports:
                airspeed_kt[slot] = reports[callsign].airspeed_kt
                for name, value in self._flight(reports[callsign]).items():
                    values[name][slot] = value
        read: Traffic = fetched(self._adopted(Traffic(**values), airspeed_kt))
        return read

    @cached_property
    def _adopted(self) -> Any:
        return shared_program(_adopted, self._world.simulator)

    def _flight(self, report: FlightReport) -> dict[str, Any]:
        """The values of a flight in `Traffic`."""
        last, radius_nm = len(report.route) - 1, report.turn_radius_nm
        # BluebirdDT's flights that start at their first fix fly to it.
        next_fix = last if report.next_fix is None else max(report.route.index(report.next_fix), 1)
        return {
            "active": True,
            "position_nm": self._world.sector.plane.to_plane(report.lat, report.lon),
            "heading_deg": report.heading_deg,
            "level_ticks": ticks(report.fl),
            "ground_speed_kt": report.ground_speed_kt,
            "vertical_speed_ft_min": report.vertical_speed_ft_min,
            "cleared_heading_deg": report.cleared_heading_deg,
            "cleared_level_ticks": ticks(report.cleared_fl),
            "own_navigation": report.own_navigation,
            "route": self._routes[report.route],
            "next_fix": next_fix,
            "turn_radius_nm": RADIUS_UNKNOWN if radius_nm is None else radius_nm,
            "climb_factor": 1.0,
            "kind": report.kind,
        }


def writable(values: Arrivals | Traffic) -> dict[str, Any]:
    """Writable copies of the arrays, by name. `candidates` is not copied."""
    return {
        name: each if each is None or name == "candidates" else np.array(each)
        for name, each in values._asdict().items()
    }


def _adopted(
    simulator: Simulator, traffic: Traffic, airspeed_kt: Float[Array, " slots"]
) -> Traffic:
    """The traffic with all clearances adopted, at the reported airspeeds.

    They are NaN for flights without a report, whose `airspeed_factor` does not change.
    """
    factor = traffic.airspeed_factor
    assert factor is not None, "arrivals have one"
    adopted = traffic._replace(
        flown_heading_deg=traffic.cleared_heading_deg,
        flown_level_ticks=traffic.cleared_level_ticks,
        turn_deg=turn_to_deg(traffic.heading_deg, traffic.cleared_heading_deg),
        cleared_fix=traffic.next_fix,
        airspeed_factor=None,
    )
    reported = airspeed_kt / simulator.true_airspeed_kt(adopted)
    return adopted._replace(airspeed_factor=jnp.where(jnp.isnan(reported), factor, reported))
