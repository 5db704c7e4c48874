"""Arriving traffic in BlueSky: flights enter and leave one by one.

    reset()                      no traffic
    enter(callsign, newborn)     a flight begins, in level flight on its heading
    issue(instruction)           clear one flight; no time passes
    remove(callsign)             a flight has left
    advance() -> reports         one radar cycle
    close()

All flights are of one of BlueSky's types, whose envelope covers nearly all speeds and levels of
Flight School traffic. They fly at their own true airspeed and rate of climb where the envelope
allows it. With `avoids`, BlueSky's own conflict resolution, the modified voltage potential (MVP),
manoeuvres them away from each other.

Needs `bluesky-simulator` (extra `[bluesky]`).
"""

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skystack.errors import PlatformError, requires_extra
from skystack.platforms.bluesky_program import (
    M_PER_FL,
    M_S_PER_FT_MIN,
    M_S_PER_KT,
    clear_bluesky,
    close_bluesky,
    fly_cycle,
    flying,
    open_bluesky,
    process,
    run_bluesky,
)
from skystack.platforms.bluesky_scenario import STEP_S, selected_speed
from skystack.platforms.flight_report import FlightReport
from skystack.platforms.instruction import Instruction
from skystack.platforms.languages import bluesky_commands
from skystack.simulator.performance import ConstantPerformance

with requires_extra(__name__, "bluesky"):
    import bluesky

TYPE = "B788"
LOOK_AHEAD_S = 300
"""The time within which conflicts are resolved, which is BlueSky's default."""
LatLon = tuple[float, float]


class Newborn(NamedTuple):
    """A flight that enters."""

    route: tuple[str, ...]
    entry_fl: float
    exit_fl: float
    lat: float
    lon: float
    heading_deg: float
    airspeed_kt: float
    """True airspeed at all levels."""
    rate_ft_min: float
    """Its rate of climb and descent."""


class _Flown(NamedTuple):
    """What BlueSky does not store about a flight."""

    newborn: Newborn
    cleared_heading_deg: float
    first_fix: int
    """The index in the route of BlueSky's first waypoint."""
    speed: str
    """The selected speed, in the format of `SPD`."""


class BlueskyTraffic:
    """Flies hours of arriving traffic, one after another.

    `fixes` are the positions of the fixes of all routes, in degrees. `separation_nm` and
    `separation_ft` are the standards that MVP keeps, if `avoids`.
    """

    def __init__(
        self,
        fixes: Mapping[str, LatLon],
        avoids: bool = False,
        separation_nm: float = 5.0,
        separation_ft: float = 1000.0,
    ) -> None:
        self._fixes, self._avoids = fixes, avoids
        self._standards = (separation_nm, separation_ft)
        self._folder = Path(tempfile.mkdtemp(prefix="skystack-bluesky-"))
        open_bluesky(self._folder)
        self._flown: dict[str, _Flown] = {}

    def reset(self) -> None:
        """Begin an hour without traffic."""
        self._flown = {}
        clear_bluesky()
        process([f"DT {STEP_S}", *(self._avoidance() if self._avoids else [])])
        run_bluesky()

    def _avoidance(self) -> list[str]:
        distance_nm, height_ft = self._standards
        return [
            "ASAS ON",
            "RESO MVP",
            f"ZONER {distance_nm:f}",
            f"ZONEDH {height_ft:f}",
            f"DTLOOK {LOOK_AHEAD_S}",
        ]

    def enter(self, callsign: str, newborn: Newborn) -> None:
        """Let a flight enter before the next cycle. Raises PlatformError if BlueSky refuses."""
        speed = _speed(newborn, newborn.entry_fl)
        process(
            [
                f"CRE {callsign} {TYPE} {newborn.lat:.10f} {newborn.lon:.10f} "
                f"{newborn.heading_deg:.10f} {100.0 * newborn.entry_fl:.6f} {speed}",
                f"SPD {callsign} {speed}",
                f"VNAV {callsign} OFF",
            ]
        )
        if callsign not in flying():
            raise PlatformError(f"BlueSky did not create {callsign}")
        self._flown[callsign] = _Flown(newborn, newborn.heading_deg, 1, speed)

    def issue(self, instruction: Instruction) -> None:
        """Clear a flight before the next cycle. Raises PlatformError if BlueSky refuses."""
        callsign = instruction.callsign
        flown, index = self._flown[callsign], flying().index(callsign)
        commands = bluesky_commands(instruction)
        if instruction.direct_to is not None:
            first = flown.newborn.route.index(instruction.direct_to)
            flown = flown._replace(first_fix=first)
            commands.append(f"DELRTE {callsign}")
            points = [self._fixes[name] for name in flown.newborn.route[first:]]
            commands += [f"ADDWPT {callsign} {lat:.10f} {lon:.10f}" for lat, lon in points]
            commands.append(f"LNAV {callsign} ON")
        if instruction.level_fl is not None:
            commands.append(f"VS {callsign} {flown.newborn.rate_ft_min:.6f}")
        process(commands)
        if instruction.heading_deg is not None:
            flown = flown._replace(cleared_heading_deg=float(instruction.heading_deg))
        self._flown[callsign] = flown
        on_route = bool(bluesky.traf.swlnav[index])
        if (instruction.direct_to is not None) != on_route and (
            instruction.heading_deg is not None or instruction.direct_to is not None
        ):
            raise PlatformError(f"BlueSky refused {instruction}")

    def remove(self, callsign: str) -> None:
        """Remove a flight that has left."""
        process([f"DEL {callsign}"])
        del self._flown[callsign]

    def advance(self) -> dict[str, FlightReport]:
        """Fly one cycle. Raises PlatformError if BlueSky fails or has lost a flight."""
        self._select_speeds()
        try:
            fly_cycle()
        except Exception as error:
            raise PlatformError(f"BlueSky failed: {type(error).__name__}: {error}") from error
        present = flying()
        places = np.stack([bluesky.traf.lat, bluesky.traf.lon, bluesky.traf.alt])
        finite = np.isfinite(places).all(axis=0)
        known = {callsign for callsign, here in zip(present, finite, strict=True) if here}
        lost = [callsign for callsign in self._flown if callsign not in known]
        if lost:
            raise PlatformError(f"BlueSky has lost {', '.join(lost)}")
        return {
            callsign: self._report(self._flown[callsign], index)
            for index, callsign in enumerate(present)
        }

    def close(self) -> None:
        """Let BlueSky be opened again, and delete its files."""
        close_bluesky()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _select_speeds(self) -> None:
        """Select each flight's airspeed again where its level has changed."""
        commands = []
        for index, callsign in enumerate(flying()):
            flown = self._flown[callsign]
            speed = _speed(flown.newborn, bluesky.traf.alt[index] / M_PER_FL)
            if speed != flown.speed:
                commands.append(f"SPD {callsign} {speed}")
                self._flown[callsign] = flown._replace(speed=speed)
        if commands:
            process(commands)

    def _report(self, flown: _Flown, index: int) -> FlightReport:
        traffic, newborn = bluesky.traf, flown.newborn
        on_route, heading = bool(traffic.swlnav[index]), float(traffic.hdg[index]) % 360.0
        reached = max(int(traffic.ap.route[index].iactwp), 0)
        last = len(newborn.route) - 1
        return FlightReport(
            route=newborn.route,
            entry_fl=newborn.entry_fl,
            exit_fl=newborn.exit_fl,
            lat=float(traffic.lat[index]),
            lon=float(traffic.lon[index]),
            fl=round(float(traffic.alt[index]) / M_PER_FL, 9),
            heading_deg=heading,
            cleared_heading_deg=heading if on_route else flown.cleared_heading_deg % 360.0,
            cleared_fl=round(float(traffic.selalt[index]) / M_PER_FL, 9),
            speed_kt=float(traffic.gs[index]) / M_S_PER_KT,
            vertical_speed_ft_min=float(traffic.vs[index]) / M_S_PER_FT_MIN,
            own_navigation=on_route,
            next_fix=newborn.route[min(flown.first_fix + reached, last)] if on_route else None,
            turn_radius_nm=None if on_route else 0.0,
            held=False,
        )


def _speed(newborn: Newborn, fl: float) -> str:
    """The flight's airspeed at a level, in the format of `SPD`."""
    return selected_speed(ConstantPerformance(newborn.airspeed_kt), round(fl, 9))
