"""Strict reading of a sector's area from GeoJSON (RFC 7946) into one ring.

Besides a plain Polygon, files in practice contain a MultiPolygon of one polygon, altitudes,
repeated vertices, or an area that is split at the antimeridian.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from skystack.airspace.projection import (
    MAX_LATITUDE_DEG,
    METRES_PER_NM,
    geodesic_leg,
    wrap_longitude,
)
from skystack.airspace.sector import STRAIGHT_WITHIN_NM, LatLon
from skystack.errors import InputError
from skystack.io.validation import not_allowed

MAX_LONGITUDE_DEG = 360.0
"""Some tools write longitudes across the antimeridian as 179, 181. Longitudes are wrapped."""
MAX_VERTICES = 500
MAX_POSITIONS = 10_000
"""The maximum number of positions in a ring of the file, before vertices are merged."""
SAME_PLACE_M = 1.0
"""Vertices closer together than this are merged."""
SWAPPED_HINT = "; are they swapped? GeoJSON lists the longitude first"
"""A hint for a position whose latitude and longitude seem to be exchanged."""

_SAME_LONGITUDE_DEG = 1e-5
"""About one metre at the equator."""


def outer_ring(area: Any) -> list[LatLon]:
    """The vertices of an area, not closed, at least a metre apart, longitudes in [-180, 180).

    `area` is a Polygon without holes; a MultiPolygon of one polygon, or of the parts of an area
    that is split at the antimeridian; or a Feature or FeatureCollection of one of these. Altitudes
    are ignored. An edge whose ends differ by more than 180 degrees of longitude crosses the
    antimeridian. Raises InputError for anything else.
    """
    rings = _rings(area)
    ring = rings[0] if len(rings) == 1 else _joined_at_antimeridian(rings)
    lat, lon = np.array(ring).reshape(-1, 2).T
    merged = merge_close_vertices(
        [(float(n), float(e)) for n, e in zip(lat, wrap_longitude(lon), strict=True)]
    )
    if not 3 <= len(merged) <= MAX_VERTICES:
        raise InputError(
            f"has {len(merged)} vertices at least a metre apart (allowed: 3 to {MAX_VERTICES})"
        )
    if abs(np.diff(unwrapped([*merged, merged[0]])[[0, -1], 0])[0]) > 180.0:
        raise InputError("contains a pole (allowed: an area that does not)")
    return merged


def merge_close_vertices(ring: Sequence[LatLon]) -> list[LatLon]:
    """A ring without vertices that are less than a metre from the previous vertex kept."""
    kept: list[LatLon] = []
    for vertex in ring:
        if not kept or _metres(kept[-1], vertex) >= SAME_PLACE_M:
            kept.append(vertex)
    while len(kept) > 1 and _metres(kept[-1], kept[0]) < SAME_PLACE_M:
        kept.pop()
    return kept


def unwrapped(ring: Sequence[LatLon]) -> Float[np.ndarray, "vertices 2"]:
    """The vertices of a ring as (longitude, latitude) [deg], continuous at the antimeridian."""
    lat, lon = np.array(ring).T
    return np.stack([np.unwrap(lon, period=360.0), lat], axis=1)


def polygon_of(ring: Sequence[LatLon]) -> dict[str, Any]:
    """The ring as a GeoJSON Polygon."""
    closed = [*ring, ring[0]]
    return {"type": "Polygon", "coordinates": [[[lon, lat] for lat, lon in closed]]}


def _metres(one: LatLon, other: LatLon) -> float:
    return geodesic_leg(one, other)[1] * METRES_PER_NM


def _rings(area: Any) -> list[list[LatLon]]:
    """The outer ring of each polygon."""
    geometry = _geometry(area)
    kind = geometry.get("type") if isinstance(geometry, Mapping) else geometry
    if not isinstance(geometry, Mapping) or kind not in ("Polygon", "MultiPolygon"):
        raise not_allowed("its GeoJSON type", kind, "Polygon, or MultiPolygon of one polygon")
    coordinates = geometry.get("coordinates")
    if kind == "Polygon":
        return [_ring_of("coordinates", coordinates)]
    if not isinstance(coordinates, list | tuple) or not coordinates:
        raise InputError("coordinates has no polygon (allowed: a MultiPolygon of one polygon)")
    if len(coordinates) > MAX_VERTICES:
        raise _separate(len(coordinates))
    return [_ring_of(f"coordinates[{n}]", polygon) for n, polygon in enumerate(coordinates)]


def _geometry(area: Any) -> Any:
    """The geometry of a Feature or of a FeatureCollection with one Feature."""
    if isinstance(area, Mapping) and area.get("type") == "FeatureCollection":
        features = area.get("features")
        if not isinstance(features, list | tuple) or len(features) != 1:
            raise InputError("is a FeatureCollection (allowed: one with exactly one Feature)")
        area = features[0]
    if isinstance(area, Mapping) and area.get("type") == "Feature":
        return area.get("geometry")
    return area


def _ring_of(where: str, polygon: Any) -> list[LatLon]:
    if not isinstance(polygon, list | tuple) or len(polygon) != 1:
        raise InputError(f"{where} must contain one ring (allowed: a Polygon without holes)")
    (positions,) = polygon
    if not isinstance(positions, list | tuple) or not positions:
        raise InputError(f"{where}[0] is not a ring (allowed: a list of positions)")
    if len(positions) > MAX_POSITIONS:
        raise InputError(
            f"{where}[0] has {len(positions)} positions (allowed: 3 to {MAX_VERTICES} vertices)"
        )
    return [_position(f"{where}[0][{n}]", position) for n, position in enumerate(positions)]


def _position(where: str, position: Any) -> LatLon:
    """Latitude and longitude. The RFC allows an altitude, and ignoring any further values."""
    all_numbers = isinstance(position, list | tuple) and all(
        isinstance(each, int | float) and not isinstance(each, bool) for each in position
    )
    allowed = (
        f"[longitude, latitude], from {-MAX_LONGITUDE_DEG:.0f} to {MAX_LONGITUDE_DEG:.0f} and "
        f"from {-MAX_LATITUDE_DEG:.0f} to {MAX_LATITUDE_DEG:.0f} degrees; an altitude is ignored"
    )
    if not all_numbers or len(position) < 2:
        raise not_allowed(where, position, allowed)
    lon, lat = position[:2]
    if not abs(lon) <= MAX_LONGITUDE_DEG or not abs(lat) <= MAX_LATITUDE_DEG:
        hint = SWAPPED_HINT if abs(lon) <= MAX_LATITUDE_DEG and abs(lat) > 90.0 else ""
        raise not_allowed(where, position, allowed + hint)
    return float(lat), float(lon)


def _separate(count: int) -> InputError:
    return InputError(
        f"is a MultiPolygon of {count} separate polygons (allowed: one polygon, or one area split "
        "at the antimeridian; keep one polygon, or write one sector file per polygon)"
    )


def _joined_at_antimeridian(rings: list[list[LatLon]]) -> list[LatLon]:
    """The area joined from parts that are split at the antimeridian (RFC 7946, section 3.1.9)."""
    # Imported here because only areas with several polygons need it.
    from shapely import Polygon, is_valid_reason, union_all  # noqa: PLC0415

    parts = []
    for number, ring in enumerate(map(merge_close_vertices, rings)):
        if len(ring) < 3:
            raise InputError(f"coordinates[{number}][0] has {len(ring)} vertices (allowed: 3)")
        lat, lon = np.array(ring).T
        lon = np.mod(lon, 360.0)  # makes the antimeridian an interior line
        lon = np.where(np.abs(lon - 180.0) < _SAME_LONGITUDE_DEG, 180.0, lon)
        parts.append(np.stack([lon, lat], axis=1))
    west = [part for part in parts if part[:, 0].max() == 180.0]
    east = [part for part in parts if part[:, 0].min() == 180.0]
    if not west or not east or len(west) + len(east) != len(parts):
        raise _separate(len(rings))
    for number, part in enumerate(parts):
        reason = is_valid_reason(Polygon(part))
        if reason != "Valid Geometry":
            raise InputError(f"coordinates[{number}] is not a simple polygon: {reason}")
    joined = union_all([Polygon(part) for part in parts])
    if joined.geom_type != "Polygon":
        raise _separate(len(rings))
    if joined.interiors:
        raise InputError("has a hole at the antimeridian (allowed: an area without holes)")
    ring = [(lat, lon) for lon, lat in joined.exterior.coords[:-1]]
    return _without_cuts(ring)


def _without_cuts(ring: list[LatLon]) -> list[LatLon]:
    """The ring without the vertices that the split at the antimeridian (180) added to its edges."""
    kept = list(ring)
    for vertex in ring:
        if vertex[1] != 180.0 or len(kept) <= 3:
            continue
        number = kept.index(vertex)
        before, after = kept[number - 1], kept[(number + 1) % len(kept)]
        scale = np.cos(np.radians(vertex[0])), 1.0
        edge, offset = (
            60.0 * np.array([end[1] - before[1], end[0] - before[0]]) * scale
            for end in (after, vertex)
        )
        off_nm = abs(edge[0] * offset[1] - edge[1] * offset[0]) / max(np.hypot(*edge), 1e-9)
        if off_nm <= STRAIGHT_WITHIN_NM and 0.0 < edge @ offset < edge @ edge:
            kept.pop(number)
    return kept
