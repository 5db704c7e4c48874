"""Sector files: JSON, with the area as GeoJSON, fully checked before use.

`docs/formats.md` (section "Sector file") describes the fields.
"""

from itertools import pairwise
from pathlib import Path, PureWindowsPath
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta

from skystack.airspace.geojson import (
    MAX_LONGITUDE_DEG,
    SAME_PLACE_M,
    SWAPPED_HINT,
    outer_ring,
    polygon_of,
    unwrapped,
)
from skystack.airspace.landing import RING_NM, is_inside
from skystack.airspace.projection import (
    MAX_LATITUDE_DEG,
    METRES_PER_NM,
    MercatorPlane,
    geodesic_leg,
    wrap_longitude,
)
from skystack.airspace.sector import MAX_DISTANCE_NM, ON_EDGE_NM, LatLon, Sector
from skystack.errors import InputError, error_context, unknown_name
from skystack.io.json_file import is_name, read_json
from skystack.io.validation import convert, not_allowed

MAX_FIXES, MAX_ROUTES, MAX_FIXES_PER_ROUTE = 1000, 200, 100
"""Limits that keep compilation and simulation to seconds. Real sectors have a few tens of each."""
SWAPPED = "; are lat and lon swapped?"

Latitude = Annotated[float, Meta(ge=-MAX_LATITUDE_DEG, le=MAX_LATITUDE_DEG)]
Longitude = Annotated[float, Meta(ge=-MAX_LONGITUDE_DEG, le=MAX_LONGITUDE_DEG)]
"""A longitude in a file. In a `Sector` longitudes are in [-180, 180)."""
Level = Annotated[int, Meta(ge=0, le=600, multiple_of=10)]


class Point(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A point in degrees."""

    lat: Latitude
    lon: Longitude


class SectorEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A sector as in a sector file or in the settings of a task."""

    name: str
    levels_fl: tuple[Level, Level]
    area: Any
    """GeoJSON, see `skystack.airspace.geojson`. In a file it can also be the name of a `.geojson`
    file in the same folder or below."""
    fixes: dict[str, Point]
    routes: tuple[tuple[str, ...], ...]
    origin: Point | None = None
    """The point where the plane's scale is 1. The default is the centre of the area."""
    separation_nm: Annotated[float, Meta(ge=0.1, le=50.0)] = 5.0
    """Horizontal separation standard. Two aircraft closer than both standards have lost
    separation."""
    separation_fl: Annotated[int, Meta(ge=1, le=100)] = 10
    """Vertical separation standard in flight levels."""

    def __hash__(self) -> int:
        # The struct's own hash would fail: `fixes` is a mapping.
        return hash((self.name, self.levels_fl, self.routes, self.origin))


def read_sector(path: Path) -> SectorEntry:
    """The checked sector of a file, including its area.

    Raises InputError for a file that cannot be read or is not a valid sector. The message is one
    line with the file, the field, its value and the allowed values.
    """
    with error_context(str(path)):
        raw = read_json(path)
        if isinstance(raw, dict) and isinstance(raw.get("area"), str):
            with error_context(f"area: {raw['area']}"):
                raw["area"] = read_json(file_in_folder(path.parent, raw["area"], ".geojson"))
        entry: SectorEntry = convert(raw, SectorEntry)
        make_sector(entry)
    # Drop the other members of a Feature: they can have types that configurations do not support.
    return msgspec.structs.replace(entry, area=polygon_of(outer_ring(entry.area)))


def file_in_folder(folder: Path, name: str, suffix: str) -> Path:
    """The path of a file in a folder or below. Raises InputError for a path that leaves it."""
    path = PureWindowsPath(name)  # recognises both separators, drives and roots
    if path.anchor or ".." in path.parts or "\0" in name or path.suffix != suffix:
        raise InputError(
            f"is not allowed (allowed: the name of a {suffix} file in the folder of this file)"
        )
    return folder / name


def make_sector(entry: SectorEntry) -> Sector:
    """The sector of an entry, with its area counter-clockwise as in GeoJSON.

    Raises InputError. The message states the field, its value and the allowed values.
    """
    _check_name("name", entry.name)
    low, high = entry.levels_fl
    if low >= high:
        raise not_allowed("levels_fl", [low, high], "the lowest level, then a higher level")
    with error_context("area"):
        ring = outer_ring(entry.area)
        origin = _origin(entry, ring)
        plane = MercatorPlane(*origin)
        area = _area(ring, plane)
    _check_count("fixes", len(entry.fixes), MAX_FIXES)
    _check_count("routes", len(entry.routes), MAX_ROUTES)
    for name, point in entry.fixes.items():
        _check_name(f"fixes: {name!r}", name)
        _check_distance(f"fixes.{name}", plane, (point.lat, point.lon), SWAPPED)
    if not entry.routes:
        raise InputError("routes is empty (allowed: at least one route)")
    fixes = {name: _lat_lon(point) for name, point in entry.fixes.items()}
    sector = Sector(
        entry.name,
        origin,
        area,
        (low, high),
        fixes,
        entry.routes,
        entry.separation_nm,
        entry.separation_fl,
    )
    with error_context("area"):
        _check_simple(sector.area_nm)  # edges that bend in the plane may cross there
    for index, route in enumerate(entry.routes):
        with error_context(f"routes[{index}]"):
            _check_route(route, index, sector)
    return sector


def _check_count(where: str, count: int, most: int) -> None:
    if count > most:
        raise InputError(f"{where} has {count} entries (allowed: at most {most})")


def _check_name(where: str, name: str) -> None:
    if not is_name(name) or len(name) > 40:
        allowed = "1 to 40 printable characters, without leading or trailing spaces"
        raise not_allowed(where, name, allowed)


def _lat_lon(point: Point) -> LatLon:
    return point.lat, float(wrap_longitude(point.lon))


def _origin(entry: SectorEntry, ring: list[LatLon]) -> LatLon:
    if entry.origin is not None:
        return _lat_lon(entry.origin)
    corners = unwrapped(ring)
    lon, lat = ((corners.min(axis=0) + corners.max(axis=0)) / 2.0).tolist()
    return lat, float(wrap_longitude(lon))


def _area(ring: list[LatLon], plane: MercatorPlane) -> tuple[LatLon, ...]:
    """The ring counter-clockwise. Raises InputError unless it is a simple polygon within limits."""
    # Imported here because only sectors from files need it.
    from shapely import LinearRing, is_ccw  # noqa: PLC0415

    for lat, lon in ring:
        _check_distance("a vertex", plane, (lat, lon), SWAPPED_HINT)
    corners = unwrapped(ring)  # edges are straight in degrees
    _check_simple(corners)
    return tuple(ring if is_ccw(LinearRing(corners)) else ring[::-1])


def _check_simple(corners: Float[np.ndarray, "corners 2"]) -> None:
    from shapely import Polygon, is_valid_reason  # noqa: PLC0415

    reason = is_valid_reason(Polygon(corners))
    if reason != "Valid Geometry":
        raise InputError(f"is not a simple polygon: {_with_coordinates(reason)}")


def _with_coordinates(reason: str) -> str:
    """Shapely's reason, such as `Self-intersection[3.1 -7.2]`, with labelled coordinates."""
    defect, _, point = reason.partition("[")
    try:
        lon, lat = (float(number) for number in point.rstrip("]").split())
    except ValueError:
        return reason
    return f"{defect} at lat {lat:.4f}, lon {float(wrap_longitude(lon)):.4f}"


def _check_distance(where: str, plane: MercatorPlane, point: LatLon, exchanged: str) -> None:
    """`exchanged` is the hint if the point with swapped coordinates is much nearer."""
    lat, lon = point
    origin = plane.origin_lat_deg, plane.origin_lon_deg
    distance_nm = geodesic_leg(origin, (lat, lon))[1]
    if distance_nm > MAX_DISTANCE_NM:
        swapped_nm = geodesic_leg(origin, (lon, lat))[1] if abs(lon) <= 90.0 else np.inf
        raise InputError(
            f"{where} is {distance_nm:.0f} NM from the origin at lat {lat}, lon {lon} "
            f"(allowed: at most {MAX_DISTANCE_NM:.0f} NM"
            + (exchanged if swapped_nm < distance_nm / 3.0 else "")
            + ")"
        )


def _check_route(route: tuple[str, ...], index: int, sector: Sector) -> None:
    """Check that a route leads through the area and leaves it over an exit fix on its edge.

    A route that ends inside the area has no exit fix to check.
    """
    from shapely import LineString, Polygon  # noqa: PLC0415

    _check_count("the route", len(route), MAX_FIXES_PER_ROUTE)
    if len(route) < 3:
        raise not_allowed("the route", list(route), "at least three fixes")
    for fix in route:
        if fix not in sector.fixes:
            raise unknown_name("fix", fix, sector.fixes)
    if route in sector.routes[:index]:
        raise not_allowed("the route", list(route), "every route only once")
    legs = (geodesic_leg(sector.fixes[a], sector.fixes[b])[1] for a, b in pairwise(route))
    if min(legs) * METRES_PER_NM < SAME_PLACE_M:
        raise not_allowed("the route", list(route), "consecutive fixes at different positions")
    area, scale = Polygon(sector.area_nm), sector.plane.scale
    within = area.intersection(LineString([sector.fixes_nm[name] for name in route]))
    if within.is_empty or within.length < scale(np.array([within.centroid.y]))[0]:  # 1 NM
        raise not_allowed("the route", list(route), "a route through the area")
    if sector.lands(route):
        _check_airport(route, sector)
    else:
        number = sector.exit_fix(route)
        exit_fix, after = route[number : number + 2]
        for name in route[number + 1 :]:
            within = is_inside(sector.fixes_nm[name], sector.area_nm)
            if within and sector.distance_to_edge_nm(name) > ON_EDGE_NM:
                raise InputError(
                    f"leaves the area after {name} without an exit fix (allowed: a fix within "
                    f"{ON_EDGE_NM} NM of the edge that the route crosses)"
                )
        _check_exit(exit_fix, sector.fixes_nm[exit_fix], sector.fixes_nm[after], sector)


def _check_airport(route: tuple[str, ...], sector: Sector) -> None:
    """Check that a flight on the route reaches its last fix, inside the area, from farther away."""
    airport = route[-1]
    inside_nm = sector.distance_to_edge_nm(airport)
    if inside_nm < RING_NM:
        raise InputError(
            f"ends at {airport}, {inside_nm:.2f} NM inside the area (allowed: outside, or at least "
            f"{RING_NM} NM inside)"
        )
    farthest_nm = max(
        geodesic_leg(sector.fixes[fix], sector.fixes[airport])[1] for fix in route[:-1]
    )
    if farthest_nm < RING_NM:
        raise InputError(
            f"ends at {airport}, and no fix is farther than {farthest_nm:.2f} NM from it (allowed: "
            f"one that is at least {RING_NM} NM away)"
        )


def _check_exit(
    name: str, exit_nm: Float[np.ndarray, "2"], after_nm: Float[np.ndarray, "2"], sector: Sector
) -> None:
    """Check that the exit fix is on an edge and that the leg after it leaves the area there."""
    from shapely import LineString, Point  # noqa: PLC0415

    edge, exit_point = LineString(sector.edge_through(name)), Point(exit_nm)
    tolerance = ON_EDGE_NM * float(sector.plane.scale(exit_nm[1:])[0])
    if edge.length <= 2.0 * tolerance:
        raise InputError(
            f"its exit fix {name} is nearest to an edge of "
            f"{edge.length / tolerance * ON_EDGE_NM:.2f} NM (allowed: an edge of more than "
            f"{2.0 * ON_EDGE_NM:.0f} NM; remove vertices there)"
        )
    along = edge.project(exit_point)
    if edge.distance(exit_point) > tolerance or not tolerance < along < edge.length - tolerance:
        corner = min(2.0 * tolerance, edge.length / 2.0)
        clear = float(np.clip(along, corner, edge.length - corner))
        nearest = np.array(edge.interpolate(clear).coords[0])
        lat, lon = sector.plane.to_degrees(nearest)
        off_nm = geodesic_leg(sector.fixes[name], (lat, lon))[1]
        raise InputError(
            f"its exit fix {name} is not on an edge of the area; lat {lat:.4f}, lon {lon:.4f} is, "
            f"{off_nm:.2f} NM away (allowed: within {ON_EDGE_NM} NM of an edge, and not at a "
            "corner)"
        )
    before, after = (
        np.array(edge.interpolate(along + step * tolerance).coords[0]) for step in (-1.0, 1.0)
    )
    direction, to_after = after - before, after_nm - before
    if direction[0] * to_after[1] - direction[1] * to_after[0] >= 0.0:
        raise InputError(
            f"the leg after its exit fix {name} does not leave the area across the edge"
        )
