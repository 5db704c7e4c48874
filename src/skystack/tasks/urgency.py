"""Which other flights matter most to a flight: those that come closest, at levels it may use."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.sector import Sector
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.pairwise_losses import Cleared, columns_of
from skystack.tasks.prediction import TIMES_S

NEIGHBOURS = 12
"""The number of other flights that are compared with each flight."""
FAR = 1e6
"""The urgency of a free slot."""
COMPARED = slice(None, None, 2)
"""The predicted times at which distances are compared: every other one."""
LATE_NM_S = 1.0 / 60.0
"""Later approaches count as more distant: 1 NM a minute."""
LEVEL_MARGIN_TICKS = ticks(20.0)
"""Added on both sides to the levels that a flight may use."""
APART_TICKS = ticks(5.0)
"""Flights whose levels are this far apart count as 1 NM more distant."""


class ScenarioFlights(NamedTuple):
    """All flights as cleared, by scenario.

    Slots are on the last axis, so that each flight can be compared with all others of its scenario
    in one loop over memory.
    """

    east_nm: Float[Array, "times batch slots"]
    north_nm: Float[Array, "times batch slots"]
    lowest_ticks: Float[Array, "batch slots"]
    """The lower of the level and the cleared level."""
    highest_ticks: Float[Array, "batch slots"]
    active: Bool[Array, "batch slots"]


def by_scenario(traffic: Traffic, cleared: Cleared, batch: int) -> ScenarioFlights:
    """The flights by scenario. They are in columns: for each slot, one column per scenario."""

    def arranged(values: Array) -> Array:
        return jnp.swapaxes(values.reshape(*values.shape[:-1], -1, batch), -1, -2)

    lowest, highest = _level_range(traffic)
    return ScenarioFlights(
        arranged(cleared.path.east_nm[COMPARED]),
        arranged(cleared.path.north_nm[COMPARED]),
        arranged(lowest),
        arranged(highest),
        arranged(traffic.active),
    )


def most_urgent(
    sector: Sector,
    scenarios: ScenarioFlights,
    traffic: Traffic,
    cleared: Cleared,
    exit_level_ticks: Float[Array, " chosen"],
    column: Int[Array, " chosen"],
) -> tuple[Int[Array, "neighbours chosen"], Float[Array, "neighbours chosen"]]:
    """For each flight, the slots of the most urgent others, and their urgency.

    `traffic`, `exit_level_ticks` and `column` describe the chosen flights, `cleared` all flights.
    """
    batch, slots = scenarios.active.shape
    scenario = column % batch
    scale = sector.plane.scale(traffic.position_nm[:, 1])[:, None]
    path = cleared.path
    own_east, own_north = columns_of((path.east_nm[COMPARED], path.north_nm[COMPARED]), column)
    nearest = jnp.full((), jnp.inf)
    for number, time_s in enumerate(TIMES_S[COMPARED]):
        east = scenarios.east_nm[number][scenario] - own_east[number][:, None]
        north = scenarios.north_nm[number][scenario] - own_north[number][:, None]
        distance = jnp.sqrt(east**2 + north**2) / scale
        nearest = jnp.minimum(nearest, distance + time_s * LATE_NM_S)
    lowest, highest = _level_range(traffic)
    lowest = jnp.minimum(lowest, exit_level_ticks) - LEVEL_MARGIN_TICKS
    highest = jnp.maximum(highest, exit_level_ticks) + LEVEL_MARGIN_TICKS
    above = scenarios.lowest_ticks[scenario] - highest[:, None]
    below = lowest[:, None] - scenarios.highest_ticks[scenario]
    score = nearest + jnp.maximum(jnp.maximum(above, below), 0.0) / APART_TICKS
    itself = jnp.arange(slots, dtype=jnp.int32)[None] == (column // batch)[:, None]
    score = jnp.where(scenarios.active[scenario] & ~itself, score, FAR)
    return _smallest(score.T, min(NEIGHBOURS, slots - 1))


def _smallest(
    score: Float[Array, "slots chosen"], count: int
) -> tuple[Int[Array, "{count} chosen"], Float[Array, "{count} chosen"]]:
    """The slots of the smallest entries of each column, in order, and these entries.

    `jax.lax.top_k` finds the same, but takes longer on CPUs.
    """
    slots = score.shape[0]
    number = jnp.arange(slots, dtype=jnp.int32)[:, None]

    def find(score: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        smallest = jnp.min(score, axis=0)
        slot = jnp.min(jnp.where(score == smallest[None], number, slots), axis=0)
        return jnp.where(number == slot[None], jnp.inf, score), (slot, smallest)

    _, (slot, smallest) = jax.lax.scan(find, score, length=count)
    return slot, smallest


def _level_range(
    traffic: Traffic,
) -> tuple[Float[Array, " columns"], Float[Array, " columns"]]:
    """The lower and the higher of the level and the cleared level."""
    level, goal = traffic.level_ticks, traffic.cleared_level_ticks
    return jnp.minimum(level, goal), jnp.maximum(level, goal)
