"""BluebirdDT's own arriving traffic: the Flight School, flown in BluebirdDT.

    reset(seed) -> reports        a new hour of traffic
    issue(instruction)            clear one flight; no time passes
    advance() -> reports          one radar cycle: births, flight, departures
    close()

Reports are by callsign. A flight that BluebirdDT removes is no longer reported: flights that have
left through their exits at their exit levels, and those far outside the sector.

Needs `bluebird-dt` (extra `[bluebird]`, AGPL).
"""

import warnings
from copy import copy
from typing import Any, NamedTuple

from skystack.errors import PlatformError, requires_extra
from skystack.platforms.bluebird import act, cleared_heading_deg, silence
from skystack.platforms.instruction import Instruction
from skystack.simulator.arrivals import Clock
from skystack.simulator.simulator import CYCLE_S

with requires_extra(__name__, "bluebird"):
    from bluebird_dt.scenario_manager.infinite import Infinite

_SECTOR = "Xplus-Sector"
_STARTERS = 2


class FlightReport(NamedTuple):
    """A flight as BluebirdDT has it."""

    route: tuple[str, ...]
    entry_fl: float
    exit_fl: float
    lat: float
    lon: float
    fl: float
    heading_deg: float
    cleared_heading_deg: float
    """The actual heading if none was cleared."""
    cleared_fl: float
    speed_kt: float
    vertical_speed_ft_min: float
    own_navigation: bool
    next_fix: str | None
    """The fix to which it flies; None if its own navigation has ended."""
    turn_radius_nm: float | None
    """That of its turn to the next fix; 0 without one, None if it is computed in the next cycle."""
    held: bool
    """Whether BluebirdDT will put it back to its position of birth, without its clearances."""


class BluebirdTraffic:
    """Flies hours of arriving traffic, one after another."""

    def __init__(self, clock: Clock) -> None:
        """`clock` has the rates, such as `FLIGHT_SCHOOL["category"]`; BluebirdDT has its own."""
        silence()
        self._clock = clock
        self._simulator: Any = None
        self._aircraft: dict[str, Any] = {}
        self._entry: dict[str, tuple[tuple[str, ...], float, float]] = {}
        """The route, entry and exit level of each flight, by callsign."""

    def reset(self, seed: int) -> dict[str, FlightReport]:
        """Begin an hour of traffic."""
        self.close()
        clock = self._clock
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # from shapely
            self._simulator = Infinite.setup(
                _SECTOR,
                use_wind=False,
                use_forecast=False,
                save_csv=False,
                save_log_to_file=False,
                autosave_interval=None,
                attach_context_to_logger=False,
                random_seed=seed,
                num_starter_aircraft=_STARTERS,
                initial_spawn_rate=clock.rate_per_s,
                spawn_rate_increment=clock.increase_per_s,
                spawn_rate_increase_interval=clock.interval_s,
                max_spawn_rate=clock.max_rate_per_s,
                total_time_seconds=clock.until_s,
            )
        self._entry, self._aircraft = {}, {}
        return self._reports()

    def issue(self, instruction: Instruction) -> None:
        """Clear a flight before the next cycle. Raises PlatformError if BluebirdDT refuses."""
        act(self._simulator, instruction.callsign, instruction)

    def advance(self) -> dict[str, FlightReport]:
        """Fly one cycle. Raises PlatformError if BluebirdDT fails."""
        try:
            self._simulator.evolve(float(CYCLE_S))
        except Exception as error:
            raise PlatformError(f"BluebirdDT failed: {type(error).__name__}: {error}") from error
        return self._reports()

    def close(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None

    def _reports(self) -> dict[str, FlightReport]:
        environment = self._simulator.manager.environment
        put_back = {each.callsign for _, each in self._simulator.scenario_manager.aircraft_to_add}
        reports = {}
        for callsign, aircraft in environment.aircraft.items():
            if self._aircraft.get(callsign) is not aircraft:  # new, or put back as another object
                self._aircraft[callsign] = aircraft
                # BluebirdDT gives flights on the same route the same object, and a clearance direct
                # to a fix changes it for all of them.
                aircraft.flight_plan.route = copy(aircraft.flight_plan.route)
            if callsign not in self._entry:
                self._entry[callsign] = _plan(environment, aircraft)
            reports[callsign] = _report(aircraft, self._entry[callsign], callsign in put_back)
        return reports


def _plan(environment: Any, aircraft: Any) -> tuple[tuple[str, ...], float, float]:
    (sector,) = environment.airspace.sectors
    exit_fl = environment.exit_coordination(sector, aircraft.callsign).fl
    return tuple(aircraft.flight_plan.route.filed), float(aircraft.fl), float(exit_fl)


def _report(aircraft: Any, plan: tuple[tuple[str, ...], float, float], held: bool) -> FlightReport:
    route, entry_fl, exit_fl = plan
    return FlightReport(
        route=route,
        entry_fl=entry_fl,
        exit_fl=exit_fl,
        lat=float(aircraft.lat),
        lon=float(aircraft.lon),
        fl=float(aircraft.fl),
        heading_deg=float(aircraft.heading) % 360.0,
        cleared_heading_deg=cleared_heading_deg(aircraft) % 360.0,
        cleared_fl=float(aircraft.selected_fl),
        speed_kt=float(aircraft.speed_tas),
        vertical_speed_ft_min=float(aircraft.vertical_speed or 0.0),
        own_navigation=bool(aircraft.on_route),
        next_fix=_next_fix(aircraft),
        turn_radius_nm=_turn_radius_nm(aircraft),
        held=held,
    )


def _next_fix(aircraft: Any) -> str | None:
    index = aircraft.next_fix_index
    return None if index is None else str(aircraft.flight_plan.route.current[index])


def _turn_radius_nm(aircraft: Any) -> float | None:
    radius, last = (
        aircraft.predictor_params.get("turn_radius"),
        aircraft.cleared_instructions.lateral_action,
    )
    if not aircraft.on_route:
        return 0.0
    if radius is None and last is not None and last.kind == "route_direct_to":
        return None
    return float(radius or 0.0)
