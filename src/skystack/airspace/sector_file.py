"""Sectors from files: JSON, its area as GeoJSON, checked before anything is computed with it.

`docs/formats.md` (section "Sector file") describes the fields.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta

from skystack.airspace.projection import (
    MAX_LATITUDE_DEG,
    METRES_PER_NM,
    MercatorPlane,
    geodesic_leg,
    wrap_longitude,
)
from skystack.airspace.sector import MAX_DISTANCE_NM, LatLon, Sector
from skystack.errors import InputError, unknown_name
from skystack.json_file import convert, inside, is_name, not_allowed, read_json

ON_EDGE_NM = 0.5
"""An exit fix lies this close to the area's edge, and further from its corners."""
MAX_VERTICES = 500
SAME_VERTEX_M = 1.0
"""Vertices closer to each other than this are one."""

Latitude = Annotated[float, Meta(ge=-MAX_LATITUDE_DEG, le=MAX_LATITUDE_DEG)]
Longitude = Annotated[float, Meta(ge=-360.0, le=360.0)]
"""As it may be written; in a sector it is in [-180, 180)."""
Level = Annotated[int, Meta(ge=0, le=600, multiple_of=10)]


class Point(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place in degrees."""

    lat: Latitude
    lon: Longitude


class SectorEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A sector as it stands in a file, and in the settings of who flies in it."""

    name: str
    levels_fl: tuple[Level, Level]
    area: Any
    """GeoJSON: a Polygon, a MultiPolygon of one, or a Feature or a collection that holds just one;
    in a file also the name of a `.geojson` beside it."""
    fixes: dict[str, Point]
    routes: tuple[tuple[str, ...], ...]
    origin: Point | None = None
    """Where the plane's scale is 1; the middle of the area where none is given."""
    separation_nm: Annotated[float, Meta(ge=0.1, le=50.0)] = 5.0
    """Two aircraft closer than this, and closer than `separation_fl`, have lost separation."""
    separation_fl: Annotated[int, Meta(ge=1, le=100)] = 10
    """Vertical separation in flight levels."""


_ENTRIES: dict[str, type[msgspec.Struct]] = {"": SectorEntry, "origin": Point, "fixes.*": Point}


def read_sector(path: Path) -> SectorEntry:
    """The sector of a file, checked, its area within.

    Raises InputError for a file that cannot be read or is no sector: one line with the file, the
    field, its value and what is allowed.
    """
    with inside(str(path)):
        raw = read_json(path)
        if isinstance(raw, dict) and isinstance(raw.get("area"), str):
            with inside(f"area: {raw['area']}"):
                raw["area"] = read_json(file_beside(path.parent, raw["area"], ".geojson"))
        entry: SectorEntry = convert(raw, _ENTRIES)
        make_sector(entry)
    # What else a Feature tells, of any type, is not for a configuration.
    plain = {"type": "Polygon", "coordinates": [_outer_ring(entry.area)]}
    return msgspec.structs.replace(entry, area=plain)


def file_beside(folder: Path, name: str, suffix: str) -> Path:
    """A file in a folder or below it. Raises InputError for a name that leads elsewhere."""
    path = Path(name)
    if path.is_absolute() or ".." in path.parts or "\0" in name or path.suffix != suffix:
        raise InputError(f"is not allowed (allowed: the name of a {suffix} file beside this one)")
    return folder / path


def make_sector(entry: SectorEntry) -> Sector:
    """The sector of an entry. Raises InputError that names the field, the value, what is allowed.

    The area becomes counter-clockwise, as GeoJSON has it.
    """
    _check_name("name", entry.name)
    low, high = entry.levels_fl
    if low >= high:
        raise not_allowed("levels_fl", [low, high], "the lowest level, then a higher one")
    with inside("area"):
        ring = _ring(entry.area)
        origin = _origin(entry, ring)
        plane = MercatorPlane(*origin)
        area = _area(ring, plane)
    for name, point in entry.fixes.items():
        _check_name(f"fixes: {name!r}", name)
        _check_distance(f"fixes.{name}", plane, point.lat, point.lon)
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
    for index, route in enumerate(entry.routes):
        with inside(f"routes[{index}]"):
            _check_route(route, index, sector)
    return sector


def _check_name(where: str, name: str) -> None:
    if not is_name(name) or len(name) > 40:
        allowed = "1 to 40 printable characters, none of them a blank at either end"
        raise not_allowed(where, name, allowed)


def _outer_ring(area: Any) -> Any:
    """The outer ring of GeoJSON as it is written there."""
    geometry = area
    if isinstance(geometry, Mapping) and geometry.get("type") == "FeatureCollection":
        features = geometry.get("features")
        if not isinstance(features, list | tuple) or len(features) != 1:
            raise InputError("is a FeatureCollection (allowed: of just one Feature)")
        geometry = features[0]
    if isinstance(geometry, Mapping) and geometry.get("type") == "Feature":
        geometry = geometry.get("geometry")
    kind = geometry.get("type") if isinstance(geometry, Mapping) else geometry
    if not isinstance(geometry, Mapping) or kind not in ("Polygon", "MultiPolygon"):
        raise not_allowed("its GeoJSON type", kind, "Polygon, or MultiPolygon of one polygon")
    polygons = geometry.get("coordinates")
    if kind == "Polygon":
        return _only_ring(polygons)
    if not isinstance(polygons, list | tuple) or not polygons:
        raise InputError("coordinates must hold a polygon (allowed: a MultiPolygon of one)")
    if len(polygons) == 1:
        return _only_ring(polygons[0])
    return _joined([_only_ring(polygon) for polygon in polygons])


def _only_ring(rings: Any) -> Any:
    if not isinstance(rings, list | tuple) or len(rings) != 1:
        raise InputError("coordinates must hold one ring (allowed: a polygon without holes)")
    return rings[0]


def _joined(rings: list[Any]) -> Any:
    """An area that is cut at the antimeridian, as RFC 7946 wants it, as one ring again."""
    from shapely import Polygon, unary_union  # noqa: PLC0415

    parts = [_unwrapped(_positions(ring)) for ring in rings]
    east = {float(lon) for part in parts for lon, _ in part}
    if {-180.0, 180.0} <= east:
        # Of the two sides of the antimeridian, the western longitudes go on eastwards.
        shifted = [
            [(lon + 360.0 if max(lon for lon, _ in part) <= 0.0 else lon, lat) for lon, lat in part]
            for part in parts
        ]
        whole = unary_union([Polygon(part) for part in shifted])
        if whole.geom_type == "Polygon" and not whole.interiors:
            return [list(point) for point in whole.simplify(0.0).exterior.coords]
    raise InputError(
        f"is a MultiPolygon of {len(rings)} polygons (allowed: one polygon, since a sector is one "
        "area; write a sector file for each)"
    )


def _positions(ring: Any) -> list[tuple[float, float]]:
    """(longitude, latitude) of a ring; an altitude, which positions may carry, is ignored."""
    allowed = (
        "[longitude, latitude] pairs, latitudes from "
        f"{-MAX_LATITUDE_DEG:.0f} to {MAX_LATITUDE_DEG:.0f}"
    )
    if not isinstance(ring, list | tuple):
        raise InputError(f"coordinates[0] is not a ring (allowed: a list of {allowed})")
    positions = []
    for index, position in enumerate(ring):
        try:
            lon, lat, *_ = msgspec.convert(position, tuple[float, ...])
            pair = msgspec.convert((lon, lat), tuple[Longitude, Latitude])
        except (msgspec.ValidationError, ValueError):
            raise not_allowed(f"coordinates[0][{index}]", position, allowed) from None
        positions.append(pair)
    return positions


def _unwrapped(positions: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The same with longitudes that never jump: each edge leads the shorter way."""
    lon, lat = np.array(positions).reshape(-1, 2).T
    step = wrap_longitude(np.diff(lon, prepend=lon[:1]))
    unwrapped = lon[:1] + np.cumsum(step)
    if len(lon) and abs(unwrapped[-1] + wrap_longitude(lon[0] - lon[-1]) - lon[0]) > 1.0:
        raise InputError("leads round a pole (allowed: an area that does not hold one)")
    # As written where nothing jumps: adding up rounds.
    turns = np.round((unwrapped - lon) / 360.0) * 360.0
    return list(zip((lon + turns).tolist(), lat.tolist(), strict=True))


def _ring(area: Any) -> list[LatLon]:
    """The outer ring of GeoJSON as (latitude, longitude), not closed, without jumps of longitude.

    Vertices less than a metre from the one before are left out.
    """
    points: list[LatLon] = []
    for lon, lat in _unwrapped(_positions(_outer_ring(area))):
        if not points or _apart_m(points[-1], (lat, lon)) >= SAME_VERTEX_M:
            points.append((lat, lon))
    while len(points) > 1 and _apart_m(points[-1], points[0]) < SAME_VERTEX_M:
        points.pop()
    if not 3 <= len(points) <= MAX_VERTICES:
        raise InputError(
            f"has {len(points)} vertices at least a metre apart (allowed: 3 to {MAX_VERTICES})"
        )
    return points


def _apart_m(first: LatLon, second: LatLon) -> float:
    return geodesic_leg(first, second)[1] * METRES_PER_NM


def _lat_lon(point: Point) -> LatLon:
    return point.lat, float(wrap_longitude(point.lon))


def _origin(entry: SectorEntry, ring: list[LatLon]) -> LatLon:
    if entry.origin is not None:
        return _lat_lon(entry.origin)
    corners = np.array(ring)
    lat, lon = ((corners.min(axis=0) + corners.max(axis=0)) / 2.0).tolist()
    return lat, float(wrap_longitude(lon))


def _area(ring: list[LatLon], plane: MercatorPlane) -> tuple[LatLon, ...]:
    """The ring counter-clockwise, if it is a plain polygon of a sector's size."""
    # Only sectors from files need it.
    from shapely import LinearRing, Polygon, is_ccw, is_valid_reason  # noqa: PLC0415

    for lat, lon in ring:
        _check_distance("a vertex", plane, lat, lon)
    # Edges are straight in degrees; x to the east.
    corners = np.array(ring)[:, ::-1]
    reason = is_valid_reason(Polygon(corners))
    if reason != "Valid Geometry":
        raise InputError(f"is no plain polygon: {_with_place(reason)}")
    in_order = ring if is_ccw(LinearRing(corners)) else ring[::-1]
    return tuple((lat, float(wrap_longitude(lon))) for lat, lon in in_order)


def _with_place(reason: str) -> str:
    """What shapely says is wrong, its place in words: `Self-intersection[3.1 -7.2]`."""
    what, _, place = reason.partition("[")
    try:
        lon, lat = (float(number) for number in place.rstrip("]").split())
    except ValueError:
        return reason
    return f"{what} at lat {lat:.4f}, lon {float(wrap_longitude(lon)):.4f}"


def _check_distance(where: str, plane: MercatorPlane, lat: float, lon: float) -> None:
    origin = plane.origin_lat_deg, plane.origin_lon_deg
    distance_nm = geodesic_leg(origin, (lat, lon))[1]
    if distance_nm > MAX_DISTANCE_NM:
        exchanged_nm = geodesic_leg(origin, (lon, lat))[1] if abs(lon) <= 90.0 else np.inf
        hint = "; are they exchanged? GeoJSON has the longitude first"
        raise InputError(
            f"{where} is {distance_nm:.0f} NM from the origin at lat {lat}, lon {lon} "
            f"(allowed: at most {MAX_DISTANCE_NM:.0f} NM"
            + (hint if exchanged_nm < distance_nm / 3.0 else "")
            + ")"
        )


def _check_route(route: tuple[str, ...], index: int, sector: Sector) -> None:
    """A route leads from outside through the area, over its exit fix on the edge, and out."""
    from shapely import LineString, Polygon, contains_xy  # noqa: PLC0415

    if len(route) < 3:
        raise not_allowed("it", list(route), "at least three fixes: outside, exit, outside")
    for fix in route:
        if fix not in sector.fixes:
            raise unknown_name("fix", fix, sector.fixes)
    if route in sector.routes[:index]:
        raise not_allowed("it", list(route), "every route once")
    points = np.array([sector.fixes_nm[name] for name in route])
    if np.any(np.all(points[1:] == points[:-1], axis=1)):
        raise not_allowed("it", list(route), "no fix at the place of the one before")
    area, exit_fix = Polygon(sector.area_nm), route[-2]
    for name in (route[0], route[-1]):
        if contains_xy(area, *sector.fixes_nm[name]):
            raise InputError(f"starts or ends at {name} inside the area (allowed: outside)")
    if area.intersection(LineString(points)).length < 1.0:
        raise not_allowed("it", list(route), "a route through the area")
    _check_exit(exit_fix, sector.fixes_nm[exit_fix], points[-1], sector)


def _check_exit(
    name: str, exit_nm: Float[np.ndarray, "2"], last_nm: Float[np.ndarray, "2"], sector: Sector
) -> None:
    """The exit fix is on one edge, and the last leg leaves the area over that edge."""
    from shapely import LineString, Point  # noqa: PLC0415

    allowed = f"the last fix but one on the area's edge, within {ON_EDGE_NM} NM, at no corner"
    edge, at = LineString(sector.edge_through(name)), Point(exit_nm)
    room = ON_EDGE_NM * float(sector.plane.scale(exit_nm[1:])[0])
    along = edge.project(at)
    if edge.distance(at) > room or not room < along < edge.length - room:
        clear = float(np.clip(along, 2.0 * room, edge.length - 2.0 * room))
        nearest = np.array(edge.interpolate(clear).coords[0])
        lat, lon = sector.plane.to_degrees(nearest)
        off_nm = geodesic_leg(sector.fixes[name], (lat, lon))[1]
        raise InputError(
            f"its exit {name} is not on an edge but {off_nm:.1f} NM off lat {lat:.4f}, "
            f"lon {lon:.4f}, which is (allowed: {allowed})"
        )
    before, after = (
        np.array(edge.interpolate(along + step * room).coords[0]) for step in (-1.0, 1.0)
    )
    direction, beyond = after - before, last_nm - before
    if direction[0] * beyond[1] - direction[1] * beyond[0] >= 0.0:
        raise InputError(f"its last leg does not lead out over the edge of {name}")
