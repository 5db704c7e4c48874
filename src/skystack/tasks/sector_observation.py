"""What a controller of a sector observes of each flight, `[observation, slots, *batch]` in [0, 1].

The rows are the flight's own features, the outlook after each clearance of
`skystack.tasks.outlook.WAYS`, and the most urgent other flights, seen from the cleared heading.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from skystack.airspace.geometry import direction
from skystack.airspace.sector import Sector
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import DIRECT, Traffic
from skystack.tasks.features import observe
from skystack.tasks.instruction_counts import begin_counts
from skystack.tasks.outlook import WAYS, Outlook
from skystack.tasks.prediction import HORIZON_S
from skystack.tasks.sector_world import WorldState
from skystack.tasks.separation import begin_separation
from skystack.tasks.tracking import Memory

SEEN = 4
"""The number of other flights that are observed."""
SINCE_CYCLES = 50.0
"""The observed time since the last transmission is at most this."""

PerFlight = Float[Array, "slots *batch"]


class Seen(NamedTuple):
    """All that is observed of a sector."""

    world: WorldState
    outlook: Outlook
    burst: Bool[Array, "slots *batch"]
    """Whether a further instruction continues a transmission."""
    since_cycles: PerFlight
    """Cycles since the last transmission."""


class OwnFeature(NamedTuple):
    """A feature of a flight; its range is scaled to [0, 1]."""

    value: Callable[[Sector, Seen], PerFlight]
    low: float
    high: float
    description: str


class OtherFeature(NamedTuple):
    """The range of a feature of another flight, which is scaled to [0, 1], and its description."""

    low: float
    high: float
    description: str
    unit: float = 1.0
    """The unit of the range in that of the computed values: flight levels are computed in ticks."""


def _flag(value: Array) -> Array:
    return value.astype(jnp.float32)


def _fl(level_ticks: Array) -> Array:
    return level_ticks / TICKS_PER_FL


OWN: dict[str, OwnFeature] = {
    "burst": OwnFeature(
        lambda sector, seen: _flag(seen.burst), 0.0, 1.0, "an instruction continues a transmission"
    ),
    "since": OwnFeature(
        lambda sector, seen: seen.since_cycles, 0.0, SINCE_CYCLES, "cycles since a transmission"
    ),
    "own_navigation": OwnFeature(
        lambda sector, seen: _flag(seen.world.traffic.own_navigation), 0.0, 1.0, "own navigation"
    ),
    "direct": OwnFeature(
        lambda sector, seen: _flag(seen.world.traffic.pending_turn == DIRECT),
        0.0,
        1.0,
        "cleared direct in this cycle",
    ),
    "entered": OwnFeature(
        lambda sector, seen: _flag(seen.world.progress.entered), 0.0, 1.0, "inside the sector"
    ),
    "speed": OwnFeature(
        lambda sector, seen: seen.world.traffic.ground_speed_kt, 300.0, 500.0, "ground speed, kt"
    ),
    "climb": OwnFeature(
        lambda sector, seen: _fl(
            seen.world.traffic.cleared_level_ticks - seen.world.traffic.level_ticks
        ),
        -200.0,
        200.0,
        "cleared level minus level, FL",
    ),
    "floor": OwnFeature(
        lambda sector, seen: (
            _fl(seen.world.traffic.cleared_level_ticks) - float(sector.levels_fl[0])
        ),
        0.0,
        100.0,
        "cleared level above the lowest level, FL",
    ),
    "ceiling": OwnFeature(
        lambda sector, seen: (
            float(sector.levels_fl[1]) - _fl(seen.world.traffic.cleared_level_ticks)
        ),
        0.0,
        100.0,
        "cleared level below the highest level, FL",
    ),
    "crowd": OwnFeature(
        lambda sector, seen: jnp.broadcast_to(
            jnp.sum(_flag(seen.world.traffic.active), axis=0), seen.since_cycles.shape
        ),
        0.0,
        100.0,
        "number of flights",
    ),
}
"""Features of a flight, in addition to those in `NAVIGATION`."""
NAVIGATION = (
    "fl_sx", "d_xfl", "theta_turn", "theta_f", "theta_sf", "d_f", "d_c", "theta_xl", "theta_xr",
    "d_x", "room", "d_edge",
)  # fmt: skip
"""Features of `skystack.tasks.features` that are also observed."""
OTHER: dict[str, OtherFeature] = {
    "right": OtherFeature(-40.0, 40.0, "distance to the right of the cleared heading, NM"),
    "ahead": OtherFeature(-40.0, 40.0, "distance ahead on the cleared heading, NM"),
    "track_sin": OtherFeature(-1.0, 1.0, "sine of its heading, from the cleared heading"),
    "track_cos": OtherFeature(-1.0, 1.0, "cosine of its heading, from the cleared heading"),
    "level": OtherFeature(-100.0, 100.0, "its level minus the own level, FL", TICKS_PER_FL),
    "cleared_level": OtherFeature(
        -100.0, 100.0, "its cleared level minus the own cleared level, FL", TICKS_PER_FL
    ),
    "climb": OtherFeature(-100.0, 100.0, "its cleared level minus its level, FL", TICKS_PER_FL),
    "time": OtherFeature(0.0, HORIZON_S, "time until separation from it is lost, as cleared, s"),
}
"""What is observed of another flight."""
NAMES = (
    *OWN,
    *NAVIGATION,
    *(f"time to loss, {way}" for way in WAYS),
    *(f"other {number + 1} {name}" for number in range(SEEN) for name in OTHER),
)


def observe_flights(sector: Sector, seen: Seen) -> Float[Array, "observation slots *batch"]:
    """The observation of every flight; zero for slots without an active flight."""
    rows = [_scaled(each.value(sector, seen), each.low, each.high) for each in OWN.values()]
    traffic = seen.world.traffic
    route = observe(NAVIGATION, sector, traffic, memory_of(seen.world))
    route = jnp.moveaxis(route.reshape(-1, len(NAVIGATION), *traffic.active.shape[1:]), 1, 0)
    times = seen.outlook.time_s / HORIZON_S
    others = _others(sector, traffic, seen.outlook)
    observed = jnp.concatenate([jnp.stack(rows), route, times, others])
    return jnp.where(traffic.active[None], observed, 0.0)


def memory_of(world: WorldState) -> Memory:
    """What the features of `skystack.tasks.features` need, without counts of instructions."""
    counts, separation = begin_counts(world.traffic), begin_separation(world.traffic)
    return Memory(world.plan, world.progress, counts, separation)


def _scaled(value: Array, low: float, high: float) -> Array:
    return jnp.clip((value - low) / (high - low), 0.0, 1.0)


def _others(
    sector: Sector, traffic: Traffic, outlook: Outlook
) -> Float[Array, "rows slots *batch"]:
    """The most urgent other flights; as if far away where there are none."""
    index = outlook.neighbour[:SEEN]

    def of_others(values: Array) -> Array:  # [slots, *batch] -> [seen, slots, *batch]
        spread = jnp.broadcast_to(values[None], (index.shape[0], *values.shape))
        return jnp.take_along_axis(spread, index, axis=1)

    scale = sector.plane.scale(traffic.position_nm[:, 1])[None]
    east, north = (
        (of_others(traffic.position_nm[:, axis]) - traffic.position_nm[None, :, axis]) / scale
        for axis in range(2)
    )
    ahead_of = direction(traffic.cleared_heading_deg)
    sin, cos = ahead_of[None, :, 0], ahead_of[None, :, 1]
    track = jnp.radians(of_others(traffic.heading_deg) - traffic.cleared_heading_deg[None])
    level = of_others(traffic.level_ticks) - traffic.level_ticks[None]
    cleared = of_others(traffic.cleared_level_ticks) - traffic.cleared_level_ticks[None]
    to_climb = of_others(traffic.cleared_level_ticks - traffic.level_ticks)
    exists = outlook.exists[:SEEN]
    values = {
        "right": jnp.where(exists, east * cos - north * sin, 0.0),
        "ahead": jnp.where(exists, east * sin + north * cos, -jnp.inf),
        "track_sin": jnp.where(exists, jnp.sin(track), 0.0),
        "track_cos": jnp.where(exists, jnp.cos(track), 0.0),
        "level": jnp.where(exists, level, jnp.inf),
        "cleared_level": jnp.where(exists, cleared, jnp.inf),
        "climb": jnp.where(exists, to_climb, 0.0),
        "time": jnp.where(exists, outlook.neighbour_time_s[:SEEN], HORIZON_S),
    }
    rows = [
        _scaled(values[name], each.low * each.unit, each.high * each.unit)
        for name, each in OTHER.items()
    ]
    stacked = jnp.stack(rows, axis=1)  # [seen, rows, slots, *batch]
    missing = SEEN - stacked.shape[0]
    if missing:  # fewer slots than flights that are observed
        stacked = jnp.pad(stacked, [(0, missing)] + [(0, 0)] * (stacked.ndim - 1))
    return stacked.reshape(-1, *stacked.shape[2:])
