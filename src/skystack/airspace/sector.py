"""A sector: its area and levels, its fixes, and the routes that lead through it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from skystack.airspace.projection import TangentPlane, geodesic_leg
from skystack.errors import InputError, unknown_name

LatLon = tuple[float, float]

MAX_DISTANCE_NM = 250.0
"""Nothing lies further from a sector's origin: the plane is no map of the world."""


class RouteTable(NamedTuple):
    """All routes of a sector as arrays, shorter ones padded with their last fix; float32, NM."""

    fixes_nm: Float[np.ndarray, "routes fixes 2"]
    last_fix: Int[np.ndarray, " routes"]
    """Index of the last fix."""
    bisector: Float[np.ndarray, "routes fixes 2"]
    """Normal of the plane through each fix that halves the angle between its legs."""
    first_heading_deg: Float[np.ndarray, " routes"]
    """Geodesic bearing of the first leg."""
    exit_edge_nm: Float[np.ndarray, "routes 2 2"]
    """The edge of the area on which the last but one fix lies, the inside to its left."""


@dataclass(frozen=True)
class Sector:
    """An airspace sector. Points are (latitude, longitude) in degrees.

    `area` is listed counter-clockwise; `levels_fl` are the lowest and the highest level, both
    inside; a route starts and ends outside, its last but one fix lying on the area's edge.
    """

    name: str
    origin: LatLon
    area: tuple[LatLon, ...]
    levels_fl: tuple[int, int]
    fixes: Mapping[str, LatLon]
    routes: tuple[tuple[str, ...], ...]

    @cached_property
    def plane(self) -> TangentPlane:
        return TangentPlane(*self.origin)

    @cached_property
    def area_nm(self) -> Float[np.ndarray, "vertices 2"]:
        """Vertices of the area in the plane, float64."""
        return self.plane.to_plane(*np.array(self.area).T)

    @cached_property
    def fixes_nm(self) -> dict[str, Float[np.ndarray, "2"]]:
        """Positions of the fixes in the plane, float64."""
        return {name: self.plane.to_plane(*point) for name, point in self.fixes.items()}

    def route_index(self, route: tuple[str, ...]) -> int:
        """Index of a route. Raises InputError when the sector has no such route."""
        for name in route:
            if name not in self.fixes:
                raise unknown_name("fix", name, self.fixes)
        if route not in self.routes:
            known = "; ".join(" ".join(r) for r in self.routes)
            raise InputError(
                f"route {' '.join(route)!r} is not a route of {self.name} (allowed: {known})"
            )
        return self.routes.index(route)

    def first_heading_deg(self, route: tuple[str, ...]) -> float:
        """Geodesic bearing of a route's first leg [deg]."""
        return geodesic_leg(self.fixes[route[0]], self.fixes[route[1]])[0]

    @cached_property
    def route_table(self) -> RouteTable:
        longest = max(len(route) for route in self.routes)
        padded = [route + route[-1:] * (longest - len(route)) for route in self.routes]
        fixes = np.array([[self.fixes_nm[name] for name in route] for route in padded])
        return RouteTable(
            fixes_nm=fixes.astype(np.float32),
            last_fix=np.array([len(route) - 1 for route in self.routes], dtype=np.int32),
            bisector=_bisectors(fixes).astype(np.float32),
            first_heading_deg=np.array(
                [self.first_heading_deg(route) for route in self.routes], dtype=np.float32
            ),
            exit_edge_nm=np.array(
                [self.edge_through(route[-2]) for route in self.routes], dtype=np.float32
            ),
        )

    def edge_through(self, fix: str) -> Float[np.ndarray, "2 2"]:
        """The edge of the area nearest to a fix: its two ends in the plane, counter-clockwise."""
        point, start = self.fixes_nm[fix], self.area_nm
        edge = np.roll(start, -1, axis=0) - start
        along = np.sum((point - start) * edge, axis=1) / np.sum(edge * edge, axis=1)
        gap = start + np.clip(along, 0.0, 1.0)[:, None] * edge - point
        nearest = int(np.argmin(np.sum(gap * gap, axis=1)))
        return np.stack([start[nearest], start[nearest] + edge[nearest]])


def _bisectors(
    fixes_nm: Float[np.ndarray, "routes fixes 2"],
) -> Float[np.ndarray, "routes fixes 2"]:
    """Sum of the unit vectors of the legs that meet at a fix; at either end the one leg's."""
    legs = np.diff(fixes_nm, axis=1)
    length = np.linalg.norm(legs, axis=2, keepdims=True)
    units = legs / np.where(length > 0.0, length, 1.0)
    bisectors = np.zeros_like(fixes_nm)
    bisectors[:, :-1] += units
    bisectors[:, 1:] += units
    return bisectors


def turns_deg(route: tuple[str, ...], fixes: Mapping[str, LatLon]) -> list[float]:
    """Change of geodesic bearing at every inner fix of a route, positive to the right."""
    legs = [geodesic_leg(fixes[a], fixes[b])[0] for a, b in pairwise(route)]
    return [(b - a + 180.0) % 360.0 - 180.0 for a, b in pairwise(legs)]
