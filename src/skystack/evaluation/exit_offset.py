"""The exit offset: the distance from the exit fix at which an aircraft crosses the exit edge.

The paper accepts an exit anywhere along the edge on which the exit fix lies, but the controller of
the next sector expects the aircraft at the fix. If a task moves the exit inside the area
(`task.exit_before_nm`), the distance is measured from where the exit meets the leg.
"""

import numpy as np
from jaxtyping import Float, Int

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.sector import Sector
from skystack.evaluation.rollout import Recording


def exit_offsets_nm(
    sector: Sector, recording: Recording
) -> Float[np.ndarray, "scenarios aircraft"]:
    """The distance of each aircraft from its exit fix when it crosses the exit edge [NM].

    NaN for an aircraft that does not leave through its exit, or lands.
    """
    exited = np.asarray(recording.status.exited)
    offsets = np.full(exited[:, 0].shape, np.nan)
    scenario, aircraft = np.nonzero(exited.any(axis=1))
    if len(scenario):
        cycle = exited.argmax(axis=1)[scenario, aircraft]
        at = (scenario, cycle, aircraft)
        before_nm = recording.before("position_nm")[at].astype(np.float64)
        after_nm = np.asarray(recording.traffic.position_nm)[at].astype(np.float64)
        route = np.asarray(recording.start.route)[scenario, aircraft]
        crossing = crossing_nm(sector, route, before_nm, after_nm)
        offsets[scenario, aircraft] = distance_to_exit_nm(sector, route, crossing)
    return offsets


def crossing_nm(
    sector: Sector,
    route: Int[np.ndarray, " exits"],
    before_nm: Float[np.ndarray, "exits 2"],
    after_nm: Float[np.ndarray, "exits 2"],
) -> Float[np.ndarray, "exits 2"]:
    """Where straight segments cross the exit edges of their routes, in the plane."""
    edges = sector.route_table.exit_edge_nm.astype(np.float64)[route]
    start, piece = edges[:, :-1], np.diff(edges, axis=1)
    flown = (after_nm - before_nm)[:, None]
    # Fractions of the flown segment and of each piece of the edge, by Cramer's rule.
    determinant = _cross(flown, piece)
    with np.errstate(divide="ignore", invalid="ignore"):
        along_flight = _cross(start - before_nm[:, None], piece) / determinant
        along_edge = _cross(start - before_nm[:, None], flown) / determinant
    chosen = np.argmin(_outside(along_flight) + _outside(along_edge), axis=1)
    fraction = np.take_along_axis(along_flight, chosen[:, None], axis=1).clip(0.0, 1.0)
    crossing: Float[np.ndarray, "exits 2"] = before_nm + fraction * flown[:, 0]
    return crossing


def _outside(fraction: Float[np.ndarray, "exits pieces"]) -> Float[np.ndarray, "exits pieces"]:
    """How far a fraction is outside [0, 1]; infinite if it is undefined."""
    beyond = np.maximum(-fraction, fraction - 1.0).clip(0.0)
    return np.where(np.isnan(beyond), np.inf, beyond)


def _cross(
    first: Float[np.ndarray, "exits #pieces 2"], second: Float[np.ndarray, "exits #pieces 2"]
) -> Float[np.ndarray, "exits pieces"]:
    product: Float[np.ndarray, "exits pieces"] = (
        first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    )
    return product


def distance_to_exit_nm(
    sector: Sector, route: Int[np.ndarray, " exits"], position_nm: Float[np.ndarray, "exits 2"]
) -> Float[np.ndarray, " exits"]:
    """Geodesic distance from positions in the plane to the exit points of their routes.

    It is NaN for routes that end inside the area, where flights land.
    """
    lat, lon = sector.plane.to_degrees(position_nm).T
    exit_lat, exit_lon = sector.exit_points[route].T
    metres = WGS84.inv(lon, lat, exit_lon, exit_lat)[2]
    lands = sector.route_table.lands[route]
    return np.where(lands, np.nan, np.asarray(metres) / METRES_PER_NM)
