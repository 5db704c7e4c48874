"""Fixed traffic: the scenarios of BluebirdDT's Springfield, `springfield:NAME`."""

from functools import cache
from typing import Any

from skystack.errors import InputError, requires_extra
from skystack.simulator.arrivals import Clock
from skystack.simulator.simulator import Simulator
from skystack.simulator.timetable import TimetableFlow
from skystack.tasks.sector_world import World

SPRINGFIELD = "springfield"
_EXTRA = "bluebird"
_SLOTS = 32
_TURN_DEG_S = 3.0
"""The rate of all turns in Springfield."""


def is_fixed(traffic: str) -> bool:
    """Whether traffic is the same in every hour."""
    return traffic.partition(":")[0] == SPRINGFIELD


def fixed_world(traffic: str, cycles: int) -> World:
    """The world of fixed traffic.

    Raises InputError for an unknown scenario, or one with too many flights.
    """
    scenario = _scenario(_name(traffic))
    if len(scenario.flights) > _SLOTS:
        raise InputError(
            f"{traffic} has {len(scenario.flights)} flights (allowed: at most {_SLOTS})"
        )
    simulator = Simulator(
        scenario.sector,
        scenario.performance,
        own_navigation=True,
        turn_rate_deg_s=_TURN_DEG_S,
        route_turn_deg_s=_TURN_DEG_S,
    )
    clock = Clock(0.0, recorded=True)
    return World(TimetableFlow(simulator, clock, _SLOTS, cycles, flights=scenario.flights))


def fixed_platform(traffic: str) -> Any:
    """Fixed traffic in BluebirdDT."""
    return _module().SpringfieldTraffic(_name(traffic))


def _name(traffic: str) -> str:
    return traffic.partition(":")[2]


@cache
def _scenario(name: str) -> Any:
    return _module().read_scenario(name)


def _module() -> Any:
    with requires_extra(f"traffic {SPRINGFIELD}", _EXTRA):
        from skystack.platforms import bluebird_springfield  # noqa: PLC0415  # an extra
    return bluebird_springfield
