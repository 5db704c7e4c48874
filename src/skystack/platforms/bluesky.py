"""BlueSky behind the platform protocol: detached, in simulation mode, in steps of one second.

Needs `bluesky-simulator` (extra `[bluesky]`); no other module imports it. BlueSky flies by its own
rules: the types and envelopes of OpenAP (speeds, Mach number, ceiling, acceleration), turns the
shorter way at 25 degrees of bank, and vertical speeds that change by 300 ft/min per second. Speeds
and rates are those of the scenario's performance, selected again when the level or the phase of
flight changes; values outside the envelope are refused. Clearances take effect in the first second
of the next cycle.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from skystack.airspace.projection import wrap_longitude
from skystack.errors import InputError, PlatformError, requires_extra
from skystack.platforms.adoption import BLUESKY
from skystack.platforms.bluesky_program import (
    M_PER_FL,
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
    check_flown_types,
    clearance_commands,
    phase_of,
    selected_speed,
    start_commands,
)
from skystack.platforms.instruction import Instruction
from skystack.platforms.protocol import Report, substitute_callsigns
from skystack.simulator.performance import ConstantPerformance, TablePerformance
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.simulator import CYCLE_S

with requires_extra(__name__, "bluesky"):
    import bluesky
    from bluesky.tools import aero

_TOLERANCE = 1e-6
"""The largest difference between a selected and a cleared heading [deg] or level [FL], and between
a Mach number and its limit."""
_SLACK_M_S = 0.01
"""How far a speed may be outside the envelope."""


class BlueSky:
    """Implements `skystack.platforms.protocol.Platform`; writes only into its folder.

    BlueSky keeps its state in its modules, so only one may be open in a process at a time.
    """

    adoption = BLUESKY

    def __init__(self, folder: Path) -> None:
        """Start BlueSky in an existing folder; the first start in a process takes some seconds."""
        open_bluesky(folder)
        self._scenario: Scenario
        self._index: dict[str, int] = {}
        self._callsigns: list[str] = []
        self._models: list[TablePerformance | ConstantPerformance] = []
        self._speeds: list[str] = []
        self._cleared_heading_deg = np.empty(0)
        self._cycle = 0

    def reset(self, scenario: Scenario) -> Report:
        check_flown_types(scenario)
        self._scenario, self._cycle = scenario, 0
        self._index = {one.callsign: index for index, one in enumerate(scenario.aircraft)}
        self._callsigns = list(substitute_callsigns(scenario).values())
        self._cleared_heading_deg = np.full(len(self._index), np.nan)
        clear_bluesky()
        self._models = [scenario.performance_of(one.type) for one in scenario.aircraft]
        self._speeds = [
            selected_speed(model, one.fl)
            for model, one in zip(self._models, scenario.aircraft, strict=True)
        ]
        process(start_commands(scenario, self._callsigns))
        self._check_start()
        run_bluesky()
        return self._report()

    def issue(self, instruction: Instruction) -> None:
        index = self._index[instruction.callsign]
        if instruction.by_direction:
            _check_direction(instruction, bluesky.traf.hdg[index])
        if instruction.level_fl is not None:
            self._check_level(index, instruction.level_fl)
        command = replace(instruction, callsign=self._callsigns[index])
        route, fixes = self._scenario.aircraft[index].route, self._scenario.sector.fixes
        process(clearance_commands(command, route, fixes, self._models[index].rate_ft_min))
        if instruction.heading_deg is not None:
            selected = bluesky.traf.ap.trk[index]
            wrong = abs((selected - instruction.heading_deg + 180.0) % 360.0 - 180.0) > _TOLERANCE
            if wrong or bluesky.traf.swlnav[index]:
                raise PlatformError(f"BlueSky refused {instruction}")
            self._cleared_heading_deg[index] = instruction.heading_deg % 360
        if instruction.direct_to is not None:
            if not bluesky.traf.swlnav[index]:
                raise PlatformError(f"BlueSky refused {instruction}")
            self._cleared_heading_deg[index] = np.nan  # on own navigation, the actual heading
        if instruction.level_fl is not None:
            selected = bluesky.traf.selalt[index] / M_PER_FL
            if abs(selected - instruction.level_fl) > _TOLERANCE:
                raise PlatformError(f"BlueSky refused {instruction}")

    def advance(self) -> Report:
        self._select_speeds()
        fly_cycle()
        self._cycle += 1
        present = set(flying())
        lost = [one for one, index in self._index.items() if self._callsigns[index] not in present]
        if lost:
            raise PlatformError(f"BlueSky has lost {', '.join(lost)}")
        if bluesky.sim.simt != self._cycle * CYCLE_S:
            raise PlatformError(f"BlueSky is at {bluesky.sim.simt} s after {self._cycle} cycles")
        return self._report()

    def close(self) -> None:
        close_bluesky()

    def _select_speeds(self) -> None:
        """Select each aircraft's speed for its level and phase of flight, where it has changed."""
        both = (flight_levels(each).tolist() for each in (bluesky.traf.alt, bluesky.traf.selalt))
        commands = []
        for index, (fl, selected_fl) in enumerate(zip(*both, strict=True)):
            speed = selected_speed(self._models[index], fl, phase_of(fl, selected_fl))
            if speed != self._speeds[index]:
                commands.append(f"SPD {self._callsigns[index]} {speed}")
            self._speeds[index] = speed
        if commands:
            process(commands)

    def _check_level(self, index: int, fl: int) -> None:
        """Raise InputError for a level that BlueSky cannot fly with the scenario's performance."""
        aircraft = self._scenario.aircraft[index]
        _check_ceiling(aircraft.callsign, fl, index)
        model, actual_fl = self._models[index], flight_levels(bluesky.traf.alt)[index]
        ceiling_fl = getattr(model, "ceiling_fl", np.inf)
        if max(ceiling_fl, actual_fl) < fl:
            raise InputError(
                f"fl is {fl} for {aircraft.callsign} (allowed: up to FL{ceiling_fl:g}, the "
                f"ceiling of {aircraft.type} in the scenario)"
            )
        _check_speed(aircraft.callsign, selected_speed(model, fl), fl, index)
        fastest = bluesky.traf.perf.vsmax[index] / M_S_PER_FT_MIN
        if model.rate_ft_min > fastest and fl != actual_fl:
            raise InputError(
                f"rate_ft_min is {model.rate_ft_min:g} for {aircraft.callsign} (allowed: up to "
                f"{fastest:.0f}, the limit of its type {bluesky.traf.perf.actype[index]} in "
                "BlueSky)"
            )

    def _check_start(self) -> None:
        """Raise InputError or PlatformError unless BlueSky has accepted the scenario unchanged."""
        if flying() != self._callsigns:
            raise PlatformError(f"BlueSky created {flying()} for {list(self._index)}")
        for index, aircraft in enumerate(self._scenario.aircraft):
            _check_ceiling(aircraft.callsign, aircraft.fl, index)
            _check_speed(aircraft.callsign, self._speeds[index], aircraft.fl, index)
            waypoints = len(aircraft.route) - 1 if aircraft.own_navigation else 0
            if (
                bluesky.traf.ap.route[index].nwp != waypoints
                or bluesky.traf.swlnav[index] != aircraft.own_navigation
            ):
                raise PlatformError(f"BlueSky refused the route of {aircraft.callsign}")

    def _report(self) -> Report:
        traffic = bluesky.traf
        heading = traffic.hdg % 360.0
        cleared = self._cleared_heading_deg
        return Report(
            lat=traffic.lat.copy(),
            lon=wrap_longitude(traffic.lon),
            fl=flight_levels(traffic.alt),
            heading_deg=heading,
            cleared_heading_deg=np.where(np.isnan(cleared), heading, cleared),
            cleared_fl=flight_levels(traffic.selalt),
            ground_speed_kt=traffic.gs / M_S_PER_KT,
            vertical_speed_ft_min=traffic.vs / M_S_PER_FT_MIN,
        )


def _check_direction(instruction: Instruction, heading_deg: float) -> None:
    """Raise InputError for a turn the longer way; BlueSky flies half a turn to the left."""
    turn = ((instruction.heading_deg or 0) - heading_deg + 180.0) % 360.0 - 180.0
    if (turn < 0.0 and instruction.turn == "right") or (turn > 0.0 and instruction.turn == "left"):
        raise InputError(
            f"turn is {instruction.turn!r} for {instruction.callsign} from heading "
            f"{heading_deg:.0f} to {instruction.heading_deg} (allowed: the shorter way, "
            "as BlueSky turns)"
        )


def _check_ceiling(callsign: str, fl: float, index: int) -> None:
    """Raise InputError for a level above the ceiling of the type in BlueSky."""
    ceiling_fl = bluesky.traf.perf.hmax[index] / M_PER_FL
    if fl > ceiling_fl:
        raise InputError(
            f"fl is {fl} for {callsign} (allowed: up to FL{ceiling_fl:.0f}, the ceiling of its "
            f"type {bluesky.traf.perf.actype[index]} in BlueSky)"
        )


def _check_speed(callsign: str, speed: str, fl: float, index: int) -> None:
    """Raise InputError for a selected speed that BlueSky would not fly in level flight."""
    limits, altitude_m = bluesky.traf.perf, fl * M_PER_FL
    if speed.startswith("M"):
        mach = float(speed[1:])
        cas_m_s = aero.vmach2cas(np.array([mach]), np.array([altitude_m])).item()
    else:
        cas_m_s = float(speed) * M_S_PER_KT
        mach = aero.vcas2mach(np.array([cas_m_s]), np.array([altitude_m])).item()
    low, high, most = limits.vmin[index], limits.vmax[index], limits.mmo[index]
    if not (low - _SLACK_M_S <= cas_m_s <= high + _SLACK_M_S and mach <= most + _TOLERANCE):
        raise InputError(
            f"{callsign} flies {cas_m_s / M_S_PER_KT:.0f} kt CAS, M{mach:.2f}, at FL{fl:g} "
            f"(allowed for its type {limits.actype[index]} in BlueSky: {low / M_S_PER_KT:.0f} "
            f"to {high / M_S_PER_KT:.0f} kt, up to M{most:.2f})"
        )
