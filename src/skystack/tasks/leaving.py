"""Predicted excursions: when flights would leave the area other than through their exits."""

from itertools import pairwise

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from skystack.airspace.geometry import crosses_outward, inside_area, points_of
from skystack.airspace.sector import Sector
from skystack.simulator.traffic import Traffic
from skystack.tasks.prediction import HORIZON_S, TIMES_S, PredictedPath

LEAVING_S = 120
"""Excursions are predicted this far ahead, in seconds."""
_TIMES = tuple(time for time in TIMES_S if time <= LEAVING_S)


def time_to_leaving(
    sector: Sector,
    traffic: Traffic,
    entered: Bool[Array, " flights"],
    path: PredictedPath,
) -> Float[Array, "paths flights"]:
    """The time until each flight would make an excursion.

    The arrays of `path` have an axis for several paths before that of the flights. The result is
    the beginning of the interval between predicted times in which the flight leaves, or `HORIZON_S`
    if it makes no excursion within `LEAVING_S`, or has not entered the area yet.
    """
    position = jnp.stack([path.east_nm[: len(_TIMES)], path.north_nm[: len(_TIMES)]], axis=1)
    outside = ~inside_area(position, sector.area_nm)[1:]
    exits = jnp.zeros_like(outside)
    before, after = position[:-1], position[1:]
    edge = points_of(sector.route_table.exit_edge_nm, traffic.route)
    spread = [jnp.broadcast_to(point.T[None, :, None], before.shape) for point in edge]
    for start, end in pairwise(spread):
        exits |= crosses_outward(before, after, start, end)
    has_exited, leaves_s = jnp.zeros_like(exits[0]), jnp.full(exits.shape[1:], HORIZON_S)
    for number, time_s in enumerate(_TIMES[:-1]):
        has_exited |= exits[number]
        leaves = outside[number] & ~has_exited & entered[None] & (leaves_s == HORIZON_S)
        leaves_s = jnp.where(leaves, float(time_s), leaves_s)
    return leaves_s
