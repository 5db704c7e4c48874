"""GeoJSON areas as found in practice: read into one ring, or refused in one line."""

import numpy as np
import pytest

from skystack.airspace.geojson import merge_close_vertices, outer_ring, unwrapped
from skystack.airspace.projection import WGS84
from skystack.errors import InputError

# Two degrees on either side of the antimeridian, split there as in RFC 7946, section 3.1.9.
WEST = [[178.0, -19.0], [180.0, -19.0], [180.0, -17.0], [178.0, -17.0], [178.0, -19.0]]
EAST = [[-180.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [-180.0, -17.0], [-180.0, -19.0]]
CORNERS = {(-19.0, 178.0), (-19.0, -178.0), (-17.0, -178.0), (-17.0, 178.0)}


def polygon(ring):
    return {"type": "Polygon", "coordinates": [ring]}


def multi(*rings):
    return {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}


def square_metres(ring):
    """The area by pyproj, on geodesic edges, which makes no difference for edges this short."""
    lat, lon = np.array(ring).T
    return abs(WGS84.polygon_area_perimeter(lon, lat)[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "area",
    [
        multi(WEST, EAST),
        multi(EAST, WEST),
        multi(WEST[::-1], EAST),
        multi(WEST[:-1], EAST[:-1]),
        multi(WEST, [[abs(lon) if lon == -180.0 else lon, lat] for lon, lat in EAST]),
        multi([[lon if lon < 179.0 else 179.999999, lat] for lon, lat in WEST], EAST),
        multi([[*at, 3000.0] for at in WEST], [[*at, 3000.0, 0.5] for at in EAST]),
        polygon([[178.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [178.0, -17.0]]),
        polygon([[178.0, -19.0], [182.0, -19.0], [182.0, -17.0], [178.0, -17.0]]),
        polygon([[-182.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [-182.0, -17.0]]),
    ],
    ids=[
        *("as in the RFC", "the eastern part first", "one part clockwise", "parts not closed"),
        *("both parts at +180", "10 cm short of 180", "altitudes"),
        *("a jump from 178 to -178", "beyond 180", "below -180"),
    ],
)
def test_joins_an_area_split_at_the_antimeridian(area):
    ring = outer_ring(area)
    assert set(ring) == CORNERS
    assert len(ring) == 4
    parts_m2 = sum(square_metres([(lat, lon) for lon, lat in part]) for part in (WEST, EAST))
    assert square_metres(ring) == pytest.approx(parts_m2, rel=1e-3)


@pytest.mark.parametrize("digits", [9, 6, 3])
def test_removes_the_vertices_of_the_split(digits):
    """A northern edge from 17.0 S to 16.3 S is split two thirds along, at a rounded latitude."""
    split = round(-17.0 + 0.7 * 2.0 / 3.0, digits)
    west = [[178.0, -19.0], [180.0, -19.0], [180.0, split], [178.0, -17.0]]
    east = [[-180.0, -19.0], [-179.0, -19.0], [-179.0, -16.3], [-180.0, split]]
    assert set(outer_ring(multi(west, east))) == {
        *((-19.0, 178.0), (-19.0, -179.0)),
        *((-16.3, -179.0), (-17.0, 178.0)),
    }


def test_a_corner_on_the_antimeridian_is_kept():
    west = [[178.0, -19.0], [180.0, -19.0], [180.0, -16.0], [178.0, -17.0]]
    east = [[-180.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [-180.0, -16.0]]
    assert set(outer_ring(multi(west, east))) == CORNERS | {(-16.0, -180.0)}


def test_180_degrees_east_is_180_degrees_west():
    ring = outer_ring(polygon(WEST))
    assert set(ring) == {(-19.0, 178.0), (-19.0, -180.0), (-17.0, -180.0), (-17.0, 178.0)}
    assert np.ptp(unwrapped(ring)[:, 0]) == 2.0


DISTANT = [[170.0, -19.0], [171.0, -19.0], [171.0, -17.0]]
OVERLAPPING = [[179.0, -19.0], [180.0, -19.0], [180.0, -18.0]]
BOW_TIE = [[178.0, -19.0], [180.0, -17.0], [180.0, -19.0], [178.0, -17.0]]
TOUCHING = [[-180.0, -17.0], [-178.0, -17.0], [-178.0, -15.0], [-180.0, -15.0]]
WITH_BAY = [[-180.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [-180.0, -17.0], [-180.0, -17.5]]
WITH_BAY += [[-179.0, -17.5], [-179.0, -18.5], [-180.0, -18.5], [-180.0, -19.0]]


@pytest.mark.parametrize(
    ("area", "message"),
    [
        (
            multi(WEST, DISTANT),
            "is a MultiPolygon of 2 separate polygons (allowed: one polygon, or",
        ),
        (multi(WEST, EAST, DISTANT), "is a MultiPolygon of 3 separate polygons"),
        (multi(WEST, OVERLAPPING), "is a MultiPolygon of 2 separate polygons"),
        (multi(WEST, TOUCHING), "is a MultiPolygon of 2 separate polygons"),
        (multi(*[DISTANT] * 501), "is a MultiPolygon of 501 separate polygons"),
        (multi(BOW_TIE, EAST), "coordinates[0] is not a simple polygon: Self-intersection"),
        (multi(WEST[:2], EAST), "coordinates[0][0] has 2 vertices"),
        (multi(WEST, WITH_BAY), "has a hole at the antimeridian"),
        (multi([], EAST), "coordinates[0][0] is not a ring"),
        (polygon([[-19.0, 178.5]]), "coordinates[0][0] is [-19.0, 178.5] (allowed: [longitude"),
        (polygon([[True, 1.0]]), "coordinates[0][0] is [true, 1.0]"),
        (polygon([[1.0, 1.0, None]]), "coordinates[0][0] is [1.0, 1.0, null]"),
        (polygon([[361.0, 1.0]]), "coordinates[0][0] is [361.0, 1.0]"),
        (polygon([[float("nan"), 1.0]]), "coordinates[0][0] is [NaN, 1.0]"),
        (polygon([[1.0, 1.0]] * 10_001), "coordinates[0] has 10001 positions"),
        (polygon([[0.0, 70.0], [120.0, 70.0], [-120.0, 70.0]]), "contains a pole"),
    ],
)
def test_refuses_an_invalid_area(area, message):
    with pytest.raises(InputError) as error:
        outer_ring(area)
    assert str(error.value).startswith(message)


def test_recognises_swapped_coordinates():
    with pytest.raises(InputError, match="are they swapped"):
        outer_ring(polygon([[lat, lon] for lon, lat in WEST]))
    with pytest.raises(InputError) as error:  # too far north, not swapped
        outer_ring(polygon([[10.0, 76.0], [11.0, 76.0], [11.0, 77.0]]))
    assert "exchanged" not in str(error.value)


@pytest.mark.parametrize("start", [(0.0, 0.0), (52.0, -179.9999999), (-74.0, 20.0)])
def test_merges_vertices_less_than_a_metre_apart(start):
    """Points to the north-east by pyproj's direct problem."""

    def beyond(metres):
        lon, lat, _ = WGS84.fwd(start[1], start[0], 45.0, metres)
        return float(lat), float(lon)

    far = [beyond(20_000.0), (start[0], beyond(20_000.0)[1])]
    assert merge_close_vertices([start, beyond(0.99), *far]) == [start, *far]
    assert merge_close_vertices([start, beyond(1.01), *far]) == [start, beyond(1.01), *far]
    assert merge_close_vertices([start, *far, beyond(0.99), start]) == [start, *far]
    # In a chain of short steps, a vertex is kept if it is a metre from the last one kept.
    chain = [beyond(0.6 * step) for step in range(6)]
    assert merge_close_vertices([*chain, *far]) == [*chain[::2], *far]
    assert merge_close_vertices([start, beyond(0.5), beyond(0.9)]) == [start]
