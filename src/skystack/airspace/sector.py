"""A sector: its area and levels, its fixes, and the routes through it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from skystack.airspace.landing import LANDING_NM, is_inside, landing_ends, landing_ring
from skystack.airspace.projection import METRES_PER_NM, WGS84, MercatorPlane, geodesic_leg
from skystack.errors import InputError, unknown_name

LatLon = tuple[float, float]

MAX_DISTANCE_NM = 400.0
"""The maximum distance of any point from the sector's origin. It allows areas 500 NM across,
including their corners."""
STRAIGHT_WITHIN_NM = 0.05
"""Lines that deviate from a straight line in the plane by at most this are treated as straight.
Edges of the area are straight in longitude and latitude, and legs of routes are geodesics."""
ON_EDGE_NM = 0.5
"""An exit fix is within this distance of an edge of the area."""
SEPARATION_TOLERANCE_NM = 0.0005
"""Allows for rounding of float32 positions. A distance of exactly the standard is not a loss of
separation; one metre less is."""


class RouteTable(NamedTuple):
    """All routes of a sector as float32 arrays. Shorter routes are padded with their last fix."""

    fixes_nm: Float[np.ndarray, "routes fixes 2"]
    last_fix: Int[np.ndarray, " routes"]
    """Index of the last fix."""
    exit_fix: Int[np.ndarray, " routes"]
    """Index of the exit fix; of the last fix if the route ends inside the area."""
    lands: Bool[np.ndarray, " routes"]
    """Whether the route ends inside the area. Its exit is then a ring around the last fix."""
    leg_nm: Float[np.ndarray, "routes legs"]
    """Geodesic length of each leg; 0 for padding."""
    leg_bulge_nm: Float[np.ndarray, "routes legs"]
    """Distance of the geodesic's midpoint to the right of the straight leg in the plane."""
    leg_direction: Float[np.ndarray, "routes fixes 2"]
    """Unit vector (east, north) at each fix along the geodesic leg to the next; 0 at the last."""
    bisector: Float[np.ndarray, "routes fixes 2"]
    """Normal (east, north) of the line through each fix that bisects the angle between its legs."""
    sharp: Bool[np.ndarray, "routes fixes"]
    """Whether the route turns by more than 90 degrees at the fix."""
    first_heading_deg: Float[np.ndarray, " routes"]
    """Geodesic bearing of the first leg."""
    exit_edge_nm: Float[np.ndarray, "routes points 2"]
    """The exit: the edge of the area with the exit fix, or the part of it within `Sector.exit_nm`
    of the fix; for a route that ends inside the area, a ring around its end. The side from which
    flights come is to its left. It has extra points where it bends in the plane, and is padded with
    its end."""
    exit_ends_nm: Float[np.ndarray, "routes 2 2"]
    """The right and the left end of the exit, as seen by a flight that approaches it."""


@dataclass(frozen=True)
class Sector:
    """An airspace sector. Points are (latitude, longitude) in degrees.

    `area` is counter-clockwise. `levels_fl` are the lowest and the highest level, both inclusive. A
    route that ends outside the area leaves it at its exit fix, which is on an edge. A route that
    ends inside the area leads to an airport.
    """

    name: str
    origin: LatLon
    area: tuple[LatLon, ...]
    levels_fl: tuple[int, int]
    fixes: Mapping[str, LatLon]
    routes: tuple[tuple[str, ...], ...]
    separation_nm: float = 5.0
    """Horizontal separation standard. Two aircraft closer than both standards have lost
    separation."""
    separation_fl: int = 10
    """Vertical separation standard in flight levels. 10 is 1,000 ft."""
    exit_nm: float | None = None
    """Half the width of an exit, along the edge of the area. None means the whole edge."""
    exit_before_nm: float = 0.0
    """How far inside the area an exit lies, along the last leg before the exit fix."""

    def __hash__(self) -> int:
        # The dataclass's own hash would fail: `fixes` is a mapping.
        fixes = tuple(sorted(self.fixes.items()))
        return hash((self.name, self.origin, self.area, self.levels_fl, fixes, self.routes))

    @cached_property
    def plane(self) -> MercatorPlane:
        return MercatorPlane(*self.origin)

    @property
    def loss_below_nm(self) -> float:
        """A computed distance below this is a loss of separation."""
        return self.separation_nm - SEPARATION_TOLERANCE_NM

    @cached_property
    def _edges_nm(self) -> list[Float[np.ndarray, "points 2"]]:
        """Each edge of the area as points in the plane, including both ends."""
        ends = pairwise((*self.area, self.area[0]))
        return [self.plane.densified(start, end, STRAIGHT_WITHIN_NM) for start, end in ends]

    @cached_property
    def area_nm(self) -> Float[np.ndarray, "vertices 2"]:
        """Vertices of the area in the plane, with extra ones where edges bend; float64."""
        return np.concatenate([edge[:-1] for edge in self._edges_nm])

    @cached_property
    def fixes_nm(self) -> dict[str, Float[np.ndarray, "2"]]:
        """Positions of the fixes in the plane; float64."""
        return {name: self.plane.to_plane(*point) for name, point in self.fixes.items()}

    def path_nm(self, fixes: tuple[str, ...]) -> Float[np.ndarray, "points 2"]:
        """The geodesic legs between fixes in the plane, for drawing.

        The points are the fixes, and others in between where a leg bends by more than
        `STRAIGHT_WITHIN_NM`.
        """
        points = [np.array([self.fixes_nm[fix] for fix in fixes[:1]]).reshape(-1, 2)]
        for start, end in pairwise(fixes):
            points += [self._between(start, end), self.fixes_nm[end][None]]
        return np.concatenate(points)

    def _between(self, start: str, end: str) -> Float[np.ndarray, "points 2"]:
        """Points on the geodesic between two fixes; none if it is straight enough."""
        (lat1, lon1), (lat2, lon2) = self.fixes[start], self.fixes[end]
        ends_nm = self.fixes_nm[start], self.fixes_nm[end]
        middle = WGS84.npts(lon1, lat1, lon2, lat2, 1)
        bend_nm = distance_to_line(
            self.plane.to_plane(middle[0][1], middle[0][0]), np.stack(ends_nm)
        )
        if bend_nm <= STRAIGHT_WITHIN_NM:
            return np.empty((0, 2))
        # Splitting an arc into n pieces divides its bend by n squared.
        pieces = int(np.ceil(np.sqrt(bend_nm / STRAIGHT_WITHIN_NM)))
        lon, lat = np.array(WGS84.npts(lon1, lat1, lon2, lat2, pieces)).T
        return self.plane.to_plane(lat, lon)

    def route_index(self, route: tuple[str, ...]) -> int:
        """Index of a route. Raises InputError if the sector has no such route."""
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
        legs = np.array([self._legs(route) for route in padded])
        before, after = _directions(legs[..., 2]), _directions(legs[..., 1])
        known = legs[..., :1] > 0.0  # padded legs have no direction
        before, after = before * known, after * known
        no_leg = np.zeros_like(fixes[:, :1])
        before, after = np.append(no_leg, before, axis=1), np.append(after, no_leg, axis=1)
        exits = [self._exit(route) for route in self.routes]
        return RouteTable(
            fixes_nm=fixes.astype(np.float32),
            last_fix=np.array([len(route) - 1 for route in self.routes], dtype=np.int32),
            exit_fix=np.array([self.exit_fix(route) for route in self.routes], dtype=np.int32),
            lands=np.array([self.lands(route) for route in self.routes]),
            leg_nm=legs[..., 0].astype(np.float32),
            leg_bulge_nm=_bulge_nm(fixes, legs).astype(np.float32),
            leg_direction=after.astype(np.float32),
            bisector=(before + after).astype(np.float32),
            sharp=np.sum(before * after, axis=2) < 0.0,
            first_heading_deg=np.array(
                [self.first_heading_deg(route) for route in self.routes], dtype=np.float32
            ),
            exit_edge_nm=_padded(exits),
            exit_ends_nm=np.array(
                [
                    self._exit_ends(route, edge)
                    for route, edge in zip(self.routes, exits, strict=True)
                ],
                dtype=np.float32,
            ),
        )

    def lands(self, route: tuple[str, ...]) -> bool:
        """Whether a route ends inside the area."""
        return is_inside(self.fixes_nm[route[-1]], self.area_nm)

    def departs(self, route: tuple[str, ...]) -> bool:
        """Whether a route starts inside the area."""
        return is_inside(self.fixes_nm[route[0]], self.area_nm)

    def exit_fix(self, route: tuple[str, ...]) -> int:
        """Index of a route's exit fix: the first one on an edge after the last one inside.

        If no fix is inside, it is the last one on an edge; without one, the second-to-last fix. If
        the route ends inside the area, it is the last fix.
        """
        last = len(route) - 1
        if self.lands(route):
            return last
        distance_nm = [self.distance_to_edge_nm(fix) for fix in route]
        on_edge = [index for index in range(1, last) if distance_nm[index] <= ON_EDGE_NM]
        inside = [
            index
            for index in range(last)
            if distance_nm[index] > ON_EDGE_NM
            and is_inside(self.fixes_nm[route[index]], self.area_nm)
        ]
        after = [index for index in on_edge if inside and index > inside[-1]]
        return after[0] if after else [last - 1, *on_edge][-1]

    def distance_to_edge_nm(self, fix: str) -> float:
        """The true distance of a fix from the nearest edge of the area."""
        return self._distances_to_edge_nm[fix]

    @cached_property
    def _distances_to_edge_nm(self) -> dict[str, float]:
        return {
            name: min(distance_to_line(point, edge) for edge in self._edges_nm)
            / self._scaled(1.0, point)
            for name, point in self.fixes_nm.items()
        }

    def _legs(self, route: tuple[str, ...]) -> Float[np.ndarray, "legs 3"]:
        """Length [NM], bearing at the start and bearing at the end [deg] of each geodesic leg."""
        lat, lon = np.array([self.fixes[name] for name in route]).T
        start, back, metres = WGS84.inv(lon[:-1], lat[:-1], lon[1:], lat[1:])
        return np.stack([metres / METRES_PER_NM, start, np.add(back, 180.0)], axis=1)

    def _exit(self, route: tuple[str, ...]) -> Float[np.ndarray, "points 2"]:
        """The exit of a route as points in the plane; flights come from the left of it."""
        fix = route[self.exit_fix(route)]
        fix_nm = self.fixes_nm[fix]
        if self.lands(route):
            return landing_ring(fix_nm, self._scaled(LANDING_NM, fix_nm))
        whole = self.edge_through(fix)
        if self.exit_nm is None and not self.exit_before_nm:
            return whole
        # Imported here, because it takes long and few tasks need it.
        from shapely import LineString, Point  # noqa: PLC0415
        from shapely.affinity import translate  # noqa: PLC0415
        from shapely.ops import substring  # noqa: PLC0415

        edge = LineString(whole)
        if self.exit_nm is not None:
            half, middle = self._scaled(self.exit_nm, fix_nm), edge.project(Point(fix_nm))
            edge = substring(edge, max(middle - half, 0.0), middle + half)
        edge = translate(edge, *(self.exit_point_nm(route) - fix_nm))
        return np.array(edge.coords)

    def _exit_ends(
        self, route: tuple[str, ...], edge: Float[np.ndarray, "points 2"]
    ) -> Float[np.ndarray, "2 2"]:
        """The right and the left end of a route's exit, whose points are `edge`."""
        if not self.lands(route):
            return edge[[0, -1]]
        before, fix = (self.fixes_nm[name] for name in route[-2:])
        return landing_ends(fix, before, self._scaled(LANDING_NM, fix))

    def exit_point_nm(self, route: tuple[str, ...]) -> Float[np.ndarray, "2"]:
        """The point of a route's exit: the exit fix, or `exit_before_nm` before it on the leg.

        For a route that ends inside the area, it is the last fix.
        """
        last = self.exit_fix(route)
        before, fix = (self.fixes_nm[name] for name in route[last - 1 : last + 1])
        if self.lands(route):
            return fix
        leg = before - fix
        point: Float[np.ndarray, "2"] = fix + leg / np.hypot(*leg) * self._scaled(
            self.exit_before_nm, fix
        )
        return point

    @cached_property
    def exit_points(self) -> Float[np.ndarray, "routes 2"]:
        """The point of each route's exit: latitude and longitude in degrees."""
        return self.plane.to_degrees(np.array([self.exit_point_nm(each) for each in self.routes]))

    def _scaled(self, distance_nm: float, point_nm: Float[np.ndarray, "2"]) -> float:
        """A true distance as one in the plane, near a point."""
        return distance_nm * float(self.plane.scale(point_nm[1:])[0])

    def edge_through(self, fix: str) -> Float[np.ndarray, "points 2"]:
        """The edge of the area nearest to a fix, as points in the plane, counter-clockwise."""
        point = self.fixes_nm[fix]
        return min(self._edges_nm, key=lambda edge: distance_to_line(point, edge))


def distance_to_line(point: Float[np.ndarray, "2"], line: Float[np.ndarray, "points 2"]) -> float:
    """Distance from a point to the nearest point of a polyline."""
    start, piece = line[:-1], np.diff(line, axis=0)
    along = np.sum((point - start) * piece, axis=1) / np.sum(piece * piece, axis=1)
    gap = start + np.clip(along, 0.0, 1.0)[:, None] * piece - point
    return float(np.min(np.hypot(*gap.T)))


def _padded(lines: list[Float[np.ndarray, "_ 2"]]) -> Float[np.ndarray, "lines most 2"]:
    """Polylines as one float32 array. Shorter ones are padded with their last point."""
    most = max(map(len, lines))
    full = [np.append(line, np.repeat(line[-1:], most - len(line), axis=0), 0) for line in lines]
    return np.array(full, dtype=np.float32)


def _directions(bearing_deg: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 2"]:
    radians = np.radians(bearing_deg)
    return np.stack([np.sin(radians), np.cos(radians)], axis=-1)


def _bulge_nm(
    fixes_nm: Float[np.ndarray, "routes fixes 2"], legs: Float[np.ndarray, "routes legs 3"]
) -> Float[np.ndarray, "routes legs"]:
    """Sagitta of each geodesic leg in the plane, positive to the right of its direction.

    The leg is treated as a circular arc that turns by the difference of its bearings.
    """
    length = np.linalg.norm(np.diff(fixes_nm, axis=1), axis=2)
    turn = np.radians((legs[..., 2] - legs[..., 1] + 180.0) % 360.0 - 180.0)
    return np.where(legs[..., 0] > 0.0, -length * turn / 8.0, 0.0)


def turns_deg(route: tuple[str, ...], fixes: Mapping[str, LatLon]) -> list[float]:
    """Change of geodesic bearing [deg] at each inner fix of a route, positive to the right."""
    legs = [geodesic_leg(fixes[a], fixes[b])[0] for a, b in pairwise(route)]
    return [(b - a + 180.0) % 360.0 - 180.0 for a, b in pairwise(legs)]
