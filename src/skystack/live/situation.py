"""The situation of live traffic: the flights, their clearances, and predicted losses of separation.

Predictions are those of `skystack.tasks.outlook`: as cleared, up to ten minutes ahead.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.live.hour import LiveHour
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.prediction import HORIZON_S
from skystack.tasks.sector_world import World, WorldState


class Conflict(NamedTuple):
    """Two flights that will lose separation, or have lost it (`in_s` is 0)."""

    callsigns: tuple[str, str]
    in_s: float


class FlightStrip(NamedTuple):
    """A flight as a controller sees it. Headings are in (0, 360]."""

    callsign: str
    fl: float
    cleared_fl: int
    heading_deg: int
    cleared_heading_deg: int | None
    """None on own navigation."""
    speed_kt: int
    next_fix: str
    exit_fix: str
    exit_fl: int
    hears: bool


class Situation:
    """Reads the situation of an hour. The outlook is compiled on first use."""

    def __init__(self, hour: LiveHour) -> None:
        self._hour = hour
        self._look: Any = shared_program(_soon, hour.world)

    def flights(self) -> list[FlightStrip]:
        """All flights, in order of birth."""
        state = self._hour.state
        in_order = sorted(self._hour.slots.items(), key=lambda each: state.arrivals.flight[each[1]])
        return [self._flight(callsign, slot) for callsign, slot in in_order]

    def _flight(self, callsign: str, slot: int) -> FlightStrip:
        state, sector = self._hour.state, self._hour.world.sector
        traffic = state.traffic
        route = sector.routes[int(traffic.route[slot])]
        own = bool(traffic.cleared_along_route[slot])
        return FlightStrip(
            callsign=callsign,
            fl=float(traffic.level_ticks[slot]) / TICKS_PER_FL,
            cleared_fl=round(float(traffic.cleared_level_ticks[slot]) / TICKS_PER_FL),
            heading_deg=_heading(traffic.heading_deg[slot]),
            cleared_heading_deg=None if own else _heading(traffic.cleared_heading_deg[slot]),
            speed_kt=round(float(traffic.ground_speed_kt[slot])),
            next_fix=route[int(state.progress.next_fix[slot])],
            exit_fix=route[-1],
            exit_fl=round(float(state.plan.exit_level_ticks[slot]) / TICKS_PER_FL),
            hears=bool(state.hears[slot]),
        )

    def conflicts(self) -> list[Conflict]:
        """Pairs of flights, the most urgent first."""
        state = self._hour.state
        soon, neighbour, time_s = fetched(self._look(state))
        name = {slot: callsign for callsign, slot in self._hour.slots.items()}
        found: dict[tuple[str, str], float] = {}
        for rank, slot in np.argwhere(soon).tolist():
            other = int(neighbour[rank, slot])
            if FREE in (state.arrivals.flight[slot], state.arrivals.flight[other]):
                continue
            pair = (name[min(slot, other)], name[max(slot, other)])
            in_s = float(time_s[rank, slot])
            found[pair] = min(in_s, found.get(pair, in_s))
        conflicts = [Conflict(pair, in_s) for pair, in_s in found.items()]
        return sorted(conflicts, key=lambda each: each.in_s)


def _soon(world: World, state: WorldState) -> tuple[Array, Array, Array]:
    """Whether each neighbour is a conflict, its slot, and the time until then."""
    outlook = world.look_ahead(state, margin_nm=0.0)
    time_s = outlook.neighbour_time_s
    return outlook.exists & (time_s < HORIZON_S), outlook.neighbour, time_s


def _heading(degrees: Any) -> int:
    return round(float(degrees)) % 360 or 360
