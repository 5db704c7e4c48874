"""Areas as real maps write them: one ring of vertices, or one line that says why not."""

import numpy as np
import pytest

from skystack.airspace.geojson import merge_near, outer_ring, unwrapped
from skystack.airspace.projection import WGS84
from skystack.errors import InputError

# Two degrees on either side of the antimeridian, cut there as RFC 7946 (section 3.1.9) has it.
WEST = [[178.0, -19.0], [180.0, -19.0], [180.0, -17.0], [178.0, -17.0], [178.0, -19.0]]
EAST = [[-180.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [-180.0, -17.0], [-180.0, -19.0]]
CORNERS = {(-19.0, 178.0), (-19.0, -178.0), (-17.0, -178.0), (-17.0, 178.0)}


def polygon(ring):
    return {"type": "Polygon", "coordinates": [ring]}


def multi(*rings):
    return {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}


def square_metres(ring):
    """By pyproj, on geodesic edges, which makes no difference where edges are this short."""
    lat, lon = np.array(ring).T
    return abs(WGS84.polygon_area_perimeter(lon, lat)[0])


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
        *("a jump", "beyond 180", "below -180"),
    ],
)
def test_an_area_across_the_antimeridian_is_one_ring(area):
    ring = outer_ring(area)
    assert set(ring) == CORNERS
    assert len(ring) == 4
    parts_m2 = sum(square_metres([(lat, lon) for lon, lat in part]) for part in (WEST, EAST))
    assert square_metres(ring) == pytest.approx(parts_m2, rel=1e-3)


@pytest.mark.parametrize("digits", [9, 6, 3])
def test_cutting_leaves_no_vertex_on_an_edge(digits):
    """A northern edge from 17.0 S to 16.3 S, cut a third of its way along; the cut is rounded."""
    cut = round(-17.0 + 0.7 * 2.0 / 3.0, digits)
    west = [[178.0, -19.0], [180.0, -19.0], [180.0, cut], [178.0, -17.0]]
    east = [[-180.0, -19.0], [-179.0, -19.0], [-179.0, -16.3], [-180.0, cut]]
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


AWAY = [[170.0, -19.0], [171.0, -19.0], [171.0, -17.0]]
BESIDE = [[179.0, -19.0], [180.0, -19.0], [180.0, -18.0]]
BOW_TIE = [[178.0, -19.0], [180.0, -17.0], [180.0, -19.0], [178.0, -17.0]]
CORNER = [[-180.0, -17.0], [-178.0, -17.0], [-178.0, -15.0], [-180.0, -15.0]]
BAY = [[-180.0, -19.0], [-178.0, -19.0], [-178.0, -17.0], [-180.0, -17.0], [-180.0, -17.5]]
BAY += [[-179.0, -17.5], [-179.0, -18.5], [-180.0, -18.5], [-180.0, -19.0]]


@pytest.mark.parametrize(
    ("area", "message"),
    [
        (multi(WEST, AWAY), "is a MultiPolygon of 2 separate polygons (allowed: one polygon, or"),
        (multi(WEST, EAST, AWAY), "is a MultiPolygon of 3 separate polygons"),
        (multi(WEST, BESIDE), "is a MultiPolygon of 2 separate polygons"),
        (multi(WEST, CORNER), "is a MultiPolygon of 2 separate polygons"),
        (multi(*[AWAY] * 501), "is a MultiPolygon of 501 separate polygons"),
        (multi(BOW_TIE, EAST), "coordinates[0] is not a simple polygon: Self-intersection"),
        (multi(WEST[:2], EAST), "coordinates[0][0] has 2 vertices"),
        (multi(WEST, BAY), "has a hole at the antimeridian"),
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
def test_what_is_no_single_area_is_refused(area, message):
    with pytest.raises(InputError) as error:
        outer_ring(area)
    assert str(error.value).startswith(message)


def test_exchanged_coordinates_are_recognised():
    with pytest.raises(InputError, match="are they swapped"):
        outer_ring(polygon([[lat, lon] for lon, lat in WEST]))
    with pytest.raises(InputError) as error:  # too far north, not exchanged
        outer_ring(polygon([[10.0, 76.0], [11.0, 76.0], [11.0, 77.0]]))
    assert "exchanged" not in str(error.value)


@pytest.mark.parametrize("start", [(0.0, 0.0), (52.0, -179.9999999), (-74.0, 20.0)])
def test_vertices_less_than_a_metre_apart_are_one(start):
    """Steps by pyproj's direct problem, to the north-east."""

    def beyond(metres):
        lon, lat, _ = WGS84.fwd(start[1], start[0], 45.0, metres)
        return float(lat), float(lon)

    far = [beyond(20_000.0), (start[0], beyond(20_000.0)[1])]
    assert merge_near([start, beyond(0.99), *far]) == [start, *far]
    assert merge_near([start, beyond(1.01), *far]) == [start, beyond(1.01), *far]
    assert merge_near([start, *far, beyond(0.99), start]) == [start, *far]
    # A chain of short steps goes on where it is a metre from the vertex kept before it.
    chain = [beyond(0.6 * step) for step in range(6)]
    assert merge_near([*chain, *far]) == [*chain[::2], *far]
    assert merge_near([start, beyond(0.5), beyond(0.9)]) == [start]
