"""Controllers written by users, in the form of the public BluebirdDT challenge.

    class MyController:
        def generate_action(self, env, observation, info):
            return {callsign: action}       # or {callsign: [action, action, ...]}

It is called before each cycle. `observation` maps the callsigns of the flights that hear the
controller to what the task observes of them. `info` has

    info["simulator_environment"].aircraft   all flights by callsign, as `FlightView`
    info["sim_time"]                         seconds since the start
    info["action_mask"]                      which actions change something, for the same flights

Actions are numbers in the task's table, `env.actions`. A list of actions is issued as one
transmission. Flights that are not named get no instruction.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from skystack.agents.callsigns import Callsigns
from skystack.agents.per_flight import FlightActions
from skystack.agents.transmission import MOST_INSTRUCTIONS, Transmission
from skystack.agents.user_modules import METHOD, Create, as_input_error
from skystack.airspace.sector import Sector
from skystack.compilation.shared import shared_program
from skystack.errors import InputError, error_context
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.tasks.plain import checked_action
from skystack.tasks.sector_control import ACTIONS, SectorControl
from skystack.tasks.sector_world import WorldState

IN_BLUEBIRD = (
    "action_noop",
    "simple_heading_left__10",
    "simple_heading_right__10",
    "simple_fl_climb__10",
    "simple_fl_descent__10",
    "route_direct_to",
)
"""The names of `ACTIONS` in the style of BluebirdDT's environments."""


class RouteView(NamedTuple):
    """A route, as names of fixes."""

    filed: tuple[str, ...]
    current: tuple[str, ...]
    """The fixes that are still ahead."""


class FlightPlanView(NamedTuple):
    """What a flight has planned."""

    route: RouteView
    entry_fl: float
    exit_fl: float
    """The level at which it must leave the sector."""


class FlightView(NamedTuple):
    """The state of a flight. Names are those of BluebirdDT's aircraft, where it has them."""

    callsign: str
    lat: float
    """Degrees, like `lon`."""
    lon: float
    fl: float
    heading: float
    """Degrees in [0, 360), like `selected_heading`."""
    selected_heading: float
    """The cleared heading."""
    selected_fl: float
    """The cleared level."""
    speed_tas: float
    """The true airspeed in knots."""
    vertical_speed: float
    """Feet per minute."""
    on_route: bool
    """Whether it is on own navigation."""
    flight_plan: FlightPlanView


class TrafficView(NamedTuple):
    """All flights, and the time."""

    aircraft: dict[str, FlightView]
    time: float
    """Seconds since the start."""


class ActionNames(NamedTuple):
    """The actions by number, as BluebirdDT's environments name them."""

    action_formatter_map: dict[int, str]


class ControllerEnvironment(NamedTuple):
    """What a controller is given as `env`."""

    sector: Sector
    actions: dict[str, int]
    """The numbers of the actions by name, such as `climb 10 FL`."""
    observation_names: tuple[str, ...]
    """The names of the observed values; see `skystack.tasks.sector_observation`."""

    def get_action_parser(self) -> ActionNames:
        """The actions as BluebirdDT's environments name them."""
        return ActionNames(dict(enumerate(IN_BLUEBIRD)))


class _Observed(Mapping[str, np.ndarray]):
    """Rows by callsign, which are computed when they are first read."""

    def __init__(self, slots: dict[str, int], rows: Callable[[], np.ndarray]) -> None:
        self._slots, self._rows = slots, rows

    def __getitem__(self, callsign: str) -> np.ndarray:
        row: np.ndarray = self._rows()[self._slots[callsign]].copy()
        return row

    def __iter__(self) -> Iterator[str]:
        return iter(self._slots)

    def __len__(self) -> int:
        return len(self._slots)

    def __repr__(self) -> str:
        return repr(dict(self))


class UserController:
    """Flies a user's controller. Implements `skystack.agents.transmission.SectorAgent`.

    `find` finds the class, of which an instance is created for each hour. What it prints goes to
    standard error.
    """

    def __init__(self, find: Callable[[], Create], task: SectorControl) -> None:
        self._find, self._flights, self._task = find, FlightActions(task), task
        self._sector = task.sector
        self._airspeed_kt = shared_program(task.flow.simulator.true_airspeed_kt)

    @cached_property
    def _create(self) -> Create:
        return self._find()

    def begin(self, state: WorldState) -> None:
        self._flights.begin()
        self._callsigns = Callsigns(self._task.flow.callsigns)
        actions = {name: number for number, name in enumerate(ACTIONS)}
        names = self._task.observation_names
        self._environment = ControllerEnvironment(self._sector, actions, names)
        with as_input_error("cannot create an instance"), redirect_stdout(sys.stderr):
            self._controller = self._create()

    def transmit(self, state: WorldState) -> list[Transmission]:
        """Raises InputError, which names cycle and callsign, for a failure or a wrong answer."""
        present = self._callsigns.follow(state)
        hearing = {name: slot for name, slot in present.items() if state.hears[slot]}
        cycle = int(state.arrivals.cycle)
        views = cache(lambda: self._flights.observe(state))
        info = {
            "simulator_environment": self._traffic(state, present),
            "sim_time": float(CYCLE_S * cycle),
            "action_mask": _Observed(hearing, lambda: views().allowed),
        }
        observation = _Observed(hearing, lambda: views().observation)
        with error_context(f"cycle {cycle}", ", "):
            with as_input_error(f"{METHOD} failed"), redirect_stdout(sys.stderr):
                answer = getattr(self._controller, METHOD)(self._environment, observation, info)
            with as_input_error("its answer cannot be read"):
                chosen = self._checked(answer, present, hearing)
            return self._flights.transmissions(state, chosen)

    def _checked(
        self, answer: Any, present: Mapping[str, int], hearing: Mapping[str, int]
    ) -> dict[int, list[int]]:
        """The actions by slot. Those for newborns that do not hear yet are left out."""
        if not isinstance(answer, Mapping):
            raise InputError(
                f"{METHOD} returned {type(answer).__name__} (allowed: a dict, actions by callsign)"
            )
        chosen = {}
        for callsign, actions in answer.items():
            if callsign not in present:
                known = callsign in self._callsigns
                raise InputError(
                    f"{callsign!s}: {'the flight has left' if known else 'unknown callsign'}"
                )
            with error_context(str(callsign)):
                checked = _checked_actions(actions)
            if callsign in hearing:
                chosen[hearing[callsign]] = checked
        return chosen

    def _traffic(self, state: WorldState, slots: Mapping[str, int]) -> TrafficView:
        traffic, plane = state.traffic, self._sector.plane
        lat, lon = plane.to_degrees(traffic.position_nm).T
        airspeed_kt = np.asarray(self._airspeed_kt(traffic))
        flights = {}
        for callsign, slot in slots.items():
            filed = tuple(self._sector.routes[int(traffic.route[slot])])
            route = RouteView(filed, filed[int(state.progress.next_fix[slot]) :])
            entry, leaves = (float(each[slot]) / TICKS_PER_FL for each in state.plan)
            flights[callsign] = FlightView(
                callsign=callsign,
                lat=float(lat[slot]),
                lon=float(lon[slot]),
                fl=float(traffic.level_ticks[slot]) / TICKS_PER_FL,
                heading=float(traffic.heading_deg[slot]) % 360.0,
                selected_heading=float(traffic.cleared_heading_deg[slot]) % 360.0,
                selected_fl=float(traffic.cleared_level_ticks[slot]) / TICKS_PER_FL,
                speed_tas=float(airspeed_kt[slot]),
                vertical_speed=float(traffic.vertical_speed_ft_min[slot]),
                on_route=bool(traffic.own_navigation[slot]),
                flight_plan=FlightPlanView(route, entry, leaves),
            )
        return TrafficView(flights, float(CYCLE_S * int(state.arrivals.cycle)))


def _checked_actions(actions: Any) -> list[int]:
    if isinstance(actions, np.ndarray):
        actions = actions.tolist()
    burst = actions if isinstance(actions, Sequence) and not isinstance(actions, str) else [actions]
    if len(burst) > MOST_INSTRUCTIONS:
        raise InputError(f"{len(burst)} actions (allowed: up to {MOST_INSTRUCTIONS})")
    return [checked_action(each, len(ACTIONS)) for each in burst]
