"""A safety net for a learned controller: it acts where the policy would let separation be lost, or
a flight leave the area elsewhere than through its exit.

A policy sees in its outlook when separation would be lost, and which clearances would prevent it,
but in rare situations it gives none of them. Air traffic control systems have safety nets for such
cases, short-term conflict alert and area proximity warning. The one here also chooses the
clearance: of those in the outlook, the one after which it is longest until either happens, with the
smallest detour.
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
AREA_ALERT_S = 60.0
"""The net acts if a flight is predicted to leave the area elsewhere within this time."""
GAIN_S = 60.0
"""The net acts only if a clearance delays what is predicted by at least this."""
_TURN_COST_FL, _DIRECT_COST_FL = 1000.0, 500.0
"""Any change of level is preferred to a clearance direct, and that to a turn."""


def alerts(outlook: Outlook) -> Bool[np.ndarray, " *flights"]:
    """For which flights the net would have to act, as they are cleared."""
    time_s, leaves_s = np.asarray(outlook.time_s), np.asarray(outlook.leaves_s)
    alert: Bool[np.ndarray, " *flights"] = time_s[CLEARED] < ALERT_S
    return alert | (leaves_s[CLEARED] < AREA_ALERT_S)


def lasts_s(outlook: Outlook) -> Float[np.ndarray, "ways *flights"]:
    """The time until each flight would lose separation or leave the area elsewhere than through its
    exit, after each clearance of `WAYS`."""
    return np.minimum(np.asarray(outlook.time_s), np.asarray(outlook.leaves_s)[PATH_OF_WAY])


def way_out(
    sector: Sector, state: WorldState, slot: int, time_s: Float[np.ndarray, " ways"]
) -> Transmission | None:
    """The clearance that the net gives to the flight in a slot. None if none gains `GAIN_S`.

    `time_s` is that of `lasts_s` for this flight.
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
