"""A safety net for a learned controller: it acts where the policy would let separation be lost.

A policy sees in its outlook when separation would be lost, and which clearances would prevent it,
but in rare situations it gives none of them. Air traffic control systems have a safety net for such
cases, short-term conflict alert. The one here also chooses the clearance: of those in the outlook,
the one after which separation is predicted to last longest, with the smallest detour.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from skystack.agents.transmission import Transmission
from skystack.airspace.sector import Sector
from skystack.simulator.traffic import ticks
from skystack.tasks.outlook import CLEARED, TURNS_DEG, changed_levels
from skystack.tasks.sector_world import WorldState

ALERT_S = 120.0
"""The net acts if a loss of separation is predicted within this time."""
GAIN_S = 60.0
"""The net acts only if a clearance delays the predicted loss by at least this."""
_TURN_COST_FL, _DIRECT_COST_FL = 1000.0, 500.0
"""Any change of level is preferred to a clearance direct, and that to a turn."""


def way_out(
    sector: Sector, state: WorldState, slot: int, time_s: Float[np.ndarray, " ways"]
) -> Transmission | None:
    """The clearance that the net gives to the flight in a slot.

    `time_s` is the flight's outlook: the time until separation would be lost after each clearance
    of `WAYS`. None if there is no alert, or if no clearance gains `GAIN_S`.
    """
    best = float(np.max(time_s))
    if time_s[CLEARED] >= ALERT_S or best < time_s[CLEARED] + GAIN_S:
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
