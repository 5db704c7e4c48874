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
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skystack.errors import PlatformError, requires_extra
from skystack.platforms.bluesky_program import (
    M_S_PER_FT_MIN,
    M_S_PER_KT,
    clear_bluesky,
    close_bluesky,
    flight_levels,
    fly_cycle,
    flying,
    open_bluesky,
    process,
    run_bluesky,
)
from skystack.platforms.bluesky_scenario import (
    STEP_S,
    BlueskyStart,
    Fixes,
    clearance_commands,
    create_commands,
    selected_speed,
)
from skystack.platforms.flight_report import FlightReport
from skystack.platforms.instruction import Instruction
from skystack.simulator.performance import ConstantPerformance

with requires_extra(__name__, "bluesky"):
    import bluesky

TYPE = "B788"
LOOK_AHEAD_S = 300
"""The time within which conflicts are resolved, which is BlueSky's default."""


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
        fixes: Fixes,
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
        start = BlueskyStart(TYPE, newborn.lat, newborn.lon, newborn.heading_deg, newborn.entry_fl)
        process([*create_commands(callsign, start, speed), f"VNAV {callsign} OFF"])
        if callsign not in flying():
            raise PlatformError(f"BlueSky did not create {callsign}")
        self._flown[callsign] = _Flown(newborn, newborn.heading_deg, 1, speed)

    def issue(self, instruction: Instruction) -> None:
        """Clear a flight before the next cycle. Raises PlatformError if BlueSky refuses."""
        callsign = instruction.callsign
        flown, index = self._flown[callsign], flying().index(callsign)
        route, rate_ft_min = flown.newborn.route, flown.newborn.rate_ft_min
        process(clearance_commands(instruction, route, self._fixes, rate_ft_min))
        on_route = bool(bluesky.traf.swlnav[index])
        if instruction.direct_to is not None:
            refused = not on_route
            flown = flown._replace(first_fix=route.index(instruction.direct_to))
        elif instruction.heading_deg is not None:
            refused = on_route
            flown = flown._replace(cleared_heading_deg=float(instruction.heading_deg))
        else:
            refused = False
        if refused:
            raise PlatformError(f"BlueSky refused {instruction}")
        self._flown[callsign] = flown

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
        levels = (flight_levels(each).tolist() for each in (bluesky.traf.alt, bluesky.traf.selalt))
        return {
            callsign: self._report(index, callsign, fl, cleared_fl)
            for index, (callsign, fl, cleared_fl) in enumerate(zip(present, *levels, strict=True))
        }

    def close(self) -> None:
        """Let BlueSky be opened again, and delete its files."""
        close_bluesky()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _select_speeds(self) -> None:
        """Select each flight's airspeed again where its level has changed."""
        commands = []
        levels_fl = flight_levels(bluesky.traf.alt).tolist()
        for callsign, fl in zip(flying(), levels_fl, strict=True):
            flown = self._flown[callsign]
            speed = _speed(flown.newborn, fl)
            if speed != flown.speed:
                commands.append(f"SPD {callsign} {speed}")
                self._flown[callsign] = flown._replace(speed=speed)
        if commands:
            process(commands)

    def _report(self, index: int, callsign: str, fl: float, cleared_fl: float) -> FlightReport:
        flown = self._flown[callsign]
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
            fl=fl,
            heading_deg=heading,
            cleared_heading_deg=heading if on_route else flown.cleared_heading_deg % 360.0,
            cleared_fl=cleared_fl,
            airspeed_kt=float(traffic.tas[index]) / M_S_PER_KT,
            ground_speed_kt=float(traffic.gs[index]) / M_S_PER_KT,
            vertical_speed_ft_min=float(traffic.vs[index]) / M_S_PER_FT_MIN,
            own_navigation=on_route,
            next_fix=newborn.route[min(flown.first_fix + reached, last)] if on_route else None,
            turn_radius_nm=None if on_route else 0.0,
            held=False,
        )


def _speed(newborn: Newborn, fl: float) -> str:
    """The flight's airspeed at a level, in the format of `SPD`."""
    return selected_speed(ConstantPerformance(newborn.airspeed_kt), fl)
