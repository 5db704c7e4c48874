"""Conversion of a platform's reports to traffic, and of traffic to scenarios."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

from skystack.airspace.projection import MercatorPlane
from skystack.platforms.adoption import SKYSTACK
from skystack.platforms.protocol import Report
from skystack.simulator.fleet import Fleet
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.scenario_file import Aircraft, Scenario
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import NO_TURN, Traffic


def traffic_of(report: Report, before: Traffic, plane: MercatorPlane) -> Traffic:
    """Reported traffic in the form that tasks read; inactive aircraft stay unchanged.

    Clearances count as adopted: the remaining turn is the shorter one to the cleared heading. The
    radius of a turn is internal to the platform, and set to 0. Levels are rounded to whole ticks.
    """
    cleared_level_ticks = np.rint(report.cleared_fl * TICKS_PER_FL)
    zero = np.zeros_like(cleared_level_ticks)
    reported = {
        "position_nm": plane.to_plane(report.lat, report.lon),
        "heading_deg": report.heading_deg,
        "level_ticks": np.rint(report.fl * TICKS_PER_FL),
        "ground_speed_kt": report.ground_speed_kt,
        "vertical_speed_ft_min": report.vertical_speed_ft_min,
        "flown_heading_deg": report.cleared_heading_deg,
        "turn_deg": SKYSTACK.shorter_turn_deg(report.heading_deg, report.cleared_heading_deg),
        "flown_level_ticks": cleared_level_ticks,
        "cleared_heading_deg": report.cleared_heading_deg,
        "cleared_level_ticks": cleared_level_ticks,
        "pending_turn": np.full_like(zero, NO_TURN),
        "turn_radius_nm": zero,
    }
    active = np.asarray(before.active)

    def of_active(name: str, new: np.ndarray) -> Array:
        old = np.asarray(getattr(before, name))
        flying = active if old.ndim == 1 else active[:, None]
        return jnp.asarray(np.where(flying, new, old).astype(old.dtype))

    return before._replace(**{name: of_active(name, new) for name, new in reported.items()})


def scenario_of(
    traffic: Traffic,
    simulator: Simulator,
    performance: str,
    cycles: int,
    callsigns: Sequence[str],
    exit_level_ticks: ArrayLike,
) -> Scenario:
    """The scenario that starts with given traffic, without clearances; levels are in ticks.

    Its fleet is the simulator's.
    """
    sector, model = simulator.sector, simulator.performance
    lat_lon = sector.plane.to_degrees(np.asarray(traffic.position_nm, dtype=np.float64))
    fl = np.asarray(traffic.level_ticks, dtype=np.float64) / TICKS_PER_FL
    exit_fl = np.rint(np.asarray(exit_level_ticks, dtype=np.float64) / TICKS_PER_FL)
    aircraft = tuple(
        Aircraft(
            callsign=callsign,
            type=model.types[int(traffic.kind[number])],
            route=sector.routes[int(traffic.route[number])],
            lat=float(lat_lon[number, 0]),
            lon=float(lat_lon[number, 1]),
            fl=float(fl[number]),
            heading_deg=float(traffic.heading_deg[number]),
            exit_fl=int(exit_fl[number]),
            own_navigation=bool(traffic.own_navigation[number]),
        )
        for number, callsign in enumerate(callsigns)
    )
    fleet = model.members if isinstance(model, Fleet) else ()
    return Scenario(sector, performance, cycles, aircraft, (), fleet)
