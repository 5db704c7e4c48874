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

from skystack.airspace.projection import MAX_LATITUDE_DEG, MercatorPlane, geodesic_leg
from skystack.airspace.sector import MAX_DISTANCE_NM, LatLon, Sector
from skystack.errors import InputError, unknown_name
from skystack.json_file import convert, inside, is_name, not_allowed, read_json

ON_EDGE_NM = 0.5
"""An exit fix lies this close to the area's edge, and further from its corners."""
MAX_VERTICES = 500
SHORTEST_EDGE_NM = 1e-3

Latitude = Annotated[float, Meta(ge=-MAX_LATITUDE_DEG, le=MAX_LATITUDE_DEG)]
Longitude = Annotated[float, Meta(ge=-180.0, le=180.0)]
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
    """GeoJSON: a Polygon, or a Feature or a collection that holds just one; in a file also the
    name of a `.geojson` beside it."""
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
    plain = {"type": "Polygon", "coordinates": [_outer(entry.area)]}
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
    fixes = {name: (point.lat, point.lon) for name, point in entry.fixes.items()}
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


def _outer(area: Any) -> Any:
    """The outer ring of GeoJSON as it stands there."""
    geometry = area
    if isinstance(geometry, Mapping) and geometry.get("type") == "FeatureCollection":
        features = geometry.get("features")
        if not isinstance(features, list | tuple) or len(features) != 1:
            raise InputError("is a FeatureCollection (allowed: of just one Feature)")
        geometry = features[0]
    if isinstance(geometry, Mapping) and geometry.get("type") == "Feature":
        geometry = geometry.get("geometry")
    kind = geometry.get("type") if isinstance(geometry, Mapping) else geometry
    if not isinstance(geometry, Mapping) or kind != "Polygon":
        raise not_allowed("its GeoJSON type", kind, "Polygon")
    rings = geometry.get("coordinates")
    if not isinstance(rings, list | tuple) or len(rings) != 1:
        raise InputError("coordinates must hold one ring (allowed: a Polygon without holes)")
    return rings[0]


def _ring(area: Any) -> list[LatLon]:
    """The outer ring of GeoJSON as (latitude, longitude), not closed."""
    try:
        points = msgspec.convert(_outer(area), tuple[tuple[Longitude, Latitude], ...])
    except msgspec.ValidationError:
        raise InputError(
            "coordinates[0] is not a ring (allowed: [longitude, latitude] pairs, "
            f"latitudes from {-MAX_LATITUDE_DEG:.0f} to {MAX_LATITUDE_DEG:.0f})"
        ) from None
    points = tuple(
        point
        for point, before in zip(points, points[-1:] + points, strict=False)
        if point != before
    )  # a vertex twice makes an edge without length
    if not 3 <= len(points) <= MAX_VERTICES:
        raise InputError(f"has {len(points)} vertices (allowed: 3 to {MAX_VERTICES})")
    east = [lon for lon, _ in points]
    if max(east) - min(east) > 180.0:
        raise InputError("lies on both sides of the 180th meridian (allowed: on one side)")
    return [(lat, lon) for lon, lat in points]


def _origin(entry: SectorEntry, ring: list[LatLon]) -> LatLon:
    if entry.origin is not None:
        return entry.origin.lat, entry.origin.lon
    corners = np.array(ring)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    return float(middle[0]), float(middle[1])


def _area(ring: list[LatLon], plane: MercatorPlane) -> tuple[LatLon, ...]:
    """The ring counter-clockwise, if it is a plain polygon of a sector's size."""
    # Only sectors from files need it.
    from shapely import LinearRing, Polygon, is_ccw, is_valid_reason  # noqa: PLC0415

    for lat, lon in ring:
        _check_distance("a vertex", plane, lat, lon)
    corners = plane.to_plane(*np.array(ring).T)
    shortest_nm = float(np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).min())
    if shortest_nm < SHORTEST_EDGE_NM:
        raise InputError(
            f"has an edge of {shortest_nm:.2g} NM (allowed: at least {SHORTEST_EDGE_NM} NM)"
        )
    reason = is_valid_reason(Polygon(corners))
    if reason != "Valid Geometry":
        raise InputError(f"is no plain polygon: {_with_degrees(reason, plane)}")
    return tuple(ring if is_ccw(LinearRing(corners)) else ring[::-1])


def _with_degrees(reason: str, plane: MercatorPlane) -> str:
    """What shapely says is wrong, its place in degrees: `Self-intersection[3.1 -7.2]`."""
    what, _, place = reason.partition("[")
    try:
        lat, lon = plane.to_degrees([float(number) for number in place.rstrip("]").split()])
    except ValueError:
        return reason
    return f"{what} at lat {lat:.4f}, lon {lon:.4f}"


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
    allowed = f"the last fix but one on the area's edge, within {ON_EDGE_NM} NM, at no corner"
    start, *_, end = sector.edge_through(name)
    edge = end - start
    along, across = edge / np.hypot(*edge), exit_nm - start
    off_nm = abs(float(along[0] * across[1] - along[1] * across[0]))
    at_nm, length_nm = float(along @ across), float(np.hypot(*edge))
    if off_nm > ON_EDGE_NM or not ON_EDGE_NM < at_nm < length_nm - ON_EDGE_NM:
        room_nm = 2.0 * ON_EDGE_NM
        nearest = start + along * float(np.clip(at_nm, room_nm, length_nm - room_nm))
        lat, lon = sector.plane.to_degrees(nearest)
        off_nm = float(np.hypot(*(exit_nm - nearest)))
        raise InputError(
            f"its exit {name} is not on an edge but {off_nm:.1f} NM off lat {lat:.4f}, "
            f"lon {lon:.4f}, which is (allowed: {allowed})"
        )
    beyond = last_nm - start
    if along[0] * beyond[1] - along[1] * beyond[0] >= 0.0:
        raise InputError(f"its last leg does not lead out over the edge of {name}")
