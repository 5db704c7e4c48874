"""A safety net for a learned controller: it acts on predicted losses of separation and excursions.

A policy observes when separation would be lost, and which clearances would prevent it, but in rare
situations it gives none of them. It does not observe predicted excursions. Air traffic control
systems have similar safety nets: short-term conflict alert and, for airspace infringements, area
proximity warning. The one here also chooses the clearance: of those in the outlook, the one that
delays the first of these events longest. Ties go to the level nearest to the exit level, then
direct to the next fix, then the smallest turn.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from skystack.agents.transmission import Transmission
from skystack.airspace.sector import Sector
from skystack.simulator.traffic import ticks
from skystack.tasks.outlook import CLEARED, PATH_OF_WAY, TURNS_DEG, Outlook, changed_levels
from skystack.tasks.sector_world import WorldState

ALERT_S = 120.0
"""The net acts if a loss of separation is predicted within this time."""
AREA_ALERT_S = 105.0
"""The net acts if an excursion is predicted within this time."""
GAIN_S = 60.0
"""The net adds a clearance only if it delays the predicted event by at least this."""
_TURN_COST_FL, _DIRECT_COST_FL = 1000.0, 500.0
"""Any change of level is preferred to a clearance direct, and that to a turn."""


def alerts(outlook: Outlook) -> Bool[np.ndarray, " *flights"]:
    """Which flights have an alert, as cleared."""
    time_s, leaves_s = np.asarray(outlook.time_s), np.asarray(outlook.leaves_s)
    alert: Bool[np.ndarray, " *flights"] = time_s[CLEARED] < ALERT_S
    return alert | (leaves_s[CLEARED] < AREA_ALERT_S)


def lasts_s(outlook: Outlook) -> Float[np.ndarray, "ways *flights"]:
    """The time until each flight would lose separation or make an excursion, after each clearance
    of `WAYS`."""
    return np.minimum(np.asarray(outlook.time_s), np.asarray(outlook.leaves_s)[PATH_OF_WAY])


def way_out(
    sector: Sector, state: WorldState, slot: int, time_s: Float[np.ndarray, " ways"]
) -> Transmission | None:
    """The clearance that the net gives to the flight in a slot. None if no clearance gains
    `GAIN_S`.

    `time_s` is this flight's column of `lasts_s`.
    """
    best = float(np.max(time_s))
    if best < time_s[CLEARED] + GAIN_S:
        return None
    ways = _ways(sector, state, slot)
    exit_level = float(state.plan.exit_level_ticks[slot])
    allowed = [way for way, time in enumerate(time_s) if time >= best and way != CLEARED]
    return min((ways[way] for way in allowed), key=lambda way: _cost(state, way, exit_level))


def _ways(sector: Sector, state: WorldState, slot: int) -> list[Transmission]:
    """The clearances of `WAYS`, in order. That of `CLEARED` is empty."""
    traffic = state.traffic
    heading_deg = round(float(traffic.cleared_heading_deg[slot]))
    exit_level, fix = float(state.plan.exit_level_ticks[slot]), int(state.progress.next_fix[slot])
    cleared = jnp.asarray(traffic.cleared_level_ticks[slot])[None]
    changed = [float(level[0]) for level in changed_levels(sector, cleared)]
    return [
        Transmission(slot),
        Transmission(slot, fix=fix),
        *(Transmission(slot, heading_deg=round(heading_deg + turn) % 360) for turn in TURNS_DEG),
        *(Transmission(slot, level_ticks=level) for level in (exit_level, *changed)),
        Transmission(slot, fix=fix, level_ticks=exit_level),
    ]


def _cost(state: WorldState, way: Transmission, exit_level: float) -> float:
    """The cost of a clearance, in flight levels. The one with the lowest is chosen."""
    if way.heading_deg is not None:
        now = float(state.traffic.cleared_heading_deg[way.slot])
        return _TURN_COST_FL + abs((way.heading_deg - now + 180.0) % 360.0 - 180.0)
    if way.level_ticks is None:
        return _DIRECT_COST_FL
    return abs(way.level_ticks - exit_level) / ticks(1.0)
