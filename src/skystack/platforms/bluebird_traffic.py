"""BluebirdDT's own traffic, flown in BluebirdDT: the Flight School, and the base class for others.

    reset(seed) -> reports        a new hour of traffic
    issue(instruction)            clear one flight; no time passes
    advance() -> reports          one radar cycle: births, flight, departures
    close()

Reports are by callsign. Flights are reported until BluebirdDT removes them, far outside the sector.

A cycle or more after a birth, BluebirdDT puts the flight back to its position of birth, without the
clearances that it has been given. Until then, it is reported at that position.

Needs `bluebird-dt` (extra `[bluebird]`, AGPL).
"""

import warnings
from copy import copy
from typing import Any

from skystack.errors import PlatformError, requires_extra
from skystack.platforms.bluebird import act, cleared_heading_deg, silence, stop_logging
from skystack.platforms.flight_report import FlightReport
from skystack.platforms.instruction import Instruction
from skystack.simulator.arrivals import Clock
from skystack.simulator.simulator import CYCLE_S

with requires_extra(__name__, "bluebird"):
    from bluebird_dt.scenario_manager.infinite import Infinite

_SECTOR = "Xplus-Sector"
_STARTERS = 2
QUIET: dict[str, Any] = {
    "use_wind": False,
    "use_forecast": False,
    "save_csv": False,
    "save_log_to_file": False,
    "autosave_interval": None,
    "attach_context_to_logger": False,
}
"""Settings with which BluebirdDT flies without wind and writes nothing."""


class BluebirdTraffic:
    """Flies traffic of BluebirdDT. Subclasses set up its simulator."""

    def __init__(self) -> None:
        silence()
        self._simulator: Any = None
        self._plans: dict[str, tuple[tuple[str, ...], float, float]] = {}
        """The route, entry and exit level of each flight, by callsign."""

    def reset(self, seed: int) -> dict[str, FlightReport]:
        """Begin the traffic of a seed."""
        self.close()
        self._plans = {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # from shapely
            self._simulator = self._set_up(seed)
        stop_logging(self._simulator)
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

    def _set_up(self, seed: int) -> Any:
        """BluebirdDT's simulator at the start."""
        raise NotImplementedError

    def _reports(self) -> dict[str, FlightReport]:
        raise NotImplementedError

    def _report(self, environment: Any, aircraft: Any, held: bool = False) -> FlightReport:
        callsign = aircraft.callsign
        if callsign not in self._plans:
            self._plans[callsign] = _plan(environment, aircraft)
        return _report(aircraft, self._plans[callsign], held)


class FlightSchoolTraffic(BluebirdTraffic):
    """Flies hours of arriving traffic, one after another."""

    def __init__(self, clock: Clock) -> None:
        """Only the rates and the end time of `clock` are used, such as `FLIGHT_SCHOOL["category"]`.

        BluebirdDT itself decides which flights enter.
        """
        super().__init__()
        self._clock = clock
        self._separate: dict[int, Any] = {}
        """The aircraft with a route of their own, by their id."""

    def _set_up(self, seed: int) -> Any:
        self._separate = {}
        clock = self._clock
        return Infinite.setup(
            _SECTOR,
            **QUIET,
            random_seed=seed,
            num_starter_aircraft=_STARTERS,
            initial_spawn_rate=clock.rate_per_s,
            spawn_rate_increment=clock.increase_per_s,
            spawn_rate_increase_interval=clock.interval_s,
            max_spawn_rate=clock.max_rate_per_s,
            total_time_seconds=clock.until_s,
        )

    def _reports(self) -> dict[str, FlightReport]:
        environment = self._simulator.manager.environment
        manager = self._simulator.scenario_manager
        later = {aircraft.callsign: aircraft for _, aircraft in manager.aircraft_to_add}
        self._separate_routes([*environment.aircraft.values(), *later.values()])
        held = later.keys() - _put_back_next(manager, environment.time)
        return {
            callsign: self._report(environment, later.get(callsign, aircraft), callsign in held)
            for callsign, aircraft in environment.aircraft.items()
        }

    def _separate_routes(self, aircraft: list[Any]) -> None:
        """Give every aircraft its own copy of its route.

        BluebirdDT gives flights on the same route the same object, and a clearance direct to a fix
        changes it for all of them.
        """
        for each in aircraft:
            if id(each) not in self._separate:
                self._separate[id(each)] = each
                each.flight_plan.route = copy(each.flight_plan.route)


def _put_back_next(manager: Any, time_s: float) -> set[str]:
    """The flights that BluebirdDT will put back in the next cycle.

    It puts none back within `min_spawn_delta` after a birth. It removes flights from the list while
    it iterates over it, and so skips every second one.
    """
    left, put_back = list(manager.aircraft_to_add), set[str]()
    if time_s - manager.last_spawn_time < manager.min_spawn_delta:
        return put_back
    for entry in left:
        if time_s >= entry[0]:
            put_back.add(entry[1].callsign)
            left.remove(entry)
    return put_back


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
        airspeed_kt=float(aircraft.speed_tas),
        # A flight that has not moved yet has no ground speed.
        ground_speed_kt=float(aircraft.ground_speed or aircraft.speed_tas),
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
