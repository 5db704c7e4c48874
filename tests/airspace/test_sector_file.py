"""Sector files: the sectors of valid files, and the messages for invalid ones."""

import json

import msgspec
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.projection import METRES_PER_NM, WGS84, MercatorPlane, geodesic_leg
from skystack.airspace.sector_file import SectorEntry, make_sector, read_sector
from skystack.airspace.sectors import find_sector, sector_named, sector_names
from skystack.errors import InputError
from tests.scenarios import EXAMPLES, changed

# A square of half a degree round 50 N 10 E; a route from west to east through its middle.
SQUARE = [[9.5, 49.5], [10.5, 49.5], [10.5, 50.5], [9.5, 50.5], [9.5, 49.5]]
PLAIN = {
    "name": "square",
    "levels_fl": [200, 400],
    "area": {"type": "Polygon", "coordinates": [SQUARE]},
    "fixes": {
        "WESTO": {"lat": 50.0, "lon": 9.3},
        "MIDDL": {"lat": 50.0, "lon": 10.0},
        "EDGED": {"lat": 50.0, "lon": 10.5},
        "EASTO": {"lat": 50.0, "lon": 10.7},
    },
    "routes": [["WESTO", "MIDDL", "EDGED", "EASTO"]],
}


def read(sector, folder):
    path = folder / "sector.json"
    path.write_text(json.dumps(sector))
    return make_sector(read_sector(path))


def test_reads_a_sector(tmp_path):
    sector = read(PLAIN, tmp_path)
    assert sector.name == "square"
    assert sector.origin == (50.0, 10.0)  # the centre
    assert sector.levels_fl == (200, 400)
    assert sector.fixes["EASTO"] == (50.0, 10.7)
    assert sector.routes == (("WESTO", "MIDDL", "EDGED", "EASTO"),)
    # The exit is the eastern edge, from south to north: 1 degree of the meridian.
    south, north = sector.edge_through("EDGED")
    length_nm = geodesic_leg((49.5, 10.5), (50.5, 10.5))[1]
    middle = sector.plane.scale((south + north)[1:] / 2.0)
    assert np.isclose((north[1] - south[1]) / middle, length_nm, rtol=1e-4)
    assert south[0] == pytest.approx(north[0], abs=1e-9)
    assert south[0] > 0.0


FEATURE = {"type": "Feature", "properties": {"name": "any"}, "geometry": PLAIN["area"]}


@pytest.mark.parametrize(
    "area",
    [
        FEATURE,
        {"type": "FeatureCollection", "features": [FEATURE]},
        {"type": "Polygon", "coordinates": [SQUARE[::-1]]},  # clockwise
        {"type": "Polygon", "coordinates": [SQUARE[:-1]]},  # not closed
        {"type": "Polygon", "coordinates": [SQUARE[:2] + SQUARE[1:]]},
        {"type": "MultiPolygon", "coordinates": [[SQUARE]]},
        FEATURE | {"geometry": {"type": "MultiPolygon", "coordinates": [[SQUARE]]}},
        {"type": "Polygon", "coordinates": [[[*at, 9144.0] for at in SQUARE]]},
        {"type": "Polygon", "coordinates": [[[lon - 360.0, lat] for lon, lat in SQUARE]]},
        {"type": "Polygon", "coordinates": [[SQUARE[0], [9.5 + 5e-6, 49.5], *SQUARE[1:]]]},
        {"type": "Polygon", "coordinates": [[*SQUARE[:-1], [9.5, 49.5 + 8e-6], SQUARE[-1]]]},
    ],
    ids=[
        *("feature", "collection", "clockwise", "open", "a repeated vertex", "multipolygon of one"),
        *("feature of a multipolygon", "altitudes", "longitudes below -180"),
        *("a vertex 0.4 m from the first", "a last vertex 0.9 m from the first"),
    ],
)
def test_reads_equivalent_areas_alike(area, tmp_path):
    sector, plain = read(changed(["area"], area, PLAIN), tmp_path), read(PLAIN, tmp_path)
    assert np.allclose(sorted(sector.area), sorted(plain.area), atol=1e-12)
    assert shapely.LinearRing(sector.area_nm).is_ccw
    assert np.allclose(sector.edge_through("EDGED"), plain.edge_through("EDGED"), atol=1e-9)


def test_vertices_more_than_a_metre_apart_are_kept(tmp_path):
    ring = [SQUARE[0], [9.5 + 2e-5, 49.5], *SQUARE[1:]]  # 1.4 m
    assert len(read(changed(["area", "coordinates", 0], ring, PLAIN), tmp_path).area) == 5


def moved(sector, lon):
    """The sector shifted east by `lon` degrees, with longitudes in [-180, 180]."""

    def wrapped(value):
        return (value + lon + 180.0) % 360.0 - 180.0

    fixes = {
        name: {"lat": at["lat"], "lon": wrapped(at["lon"])} for name, at in sector["fixes"].items()
    }
    ring = [[wrapped(east), north] for east, north in sector["area"]["coordinates"][0]]
    area = {"type": "Polygon", "coordinates": [ring]}
    return sector | {"fixes": fixes, "area": area}


@pytest.mark.parametrize("lon", [169.5, 170.0, 170.25, -190.2, 169.4])
def test_a_sector_is_the_same_across_the_antimeridian(lon, tmp_path):
    shifted, plain = read(moved(PLAIN, lon), tmp_path), read(PLAIN, tmp_path)
    assert np.allclose(shifted.area_nm, plain.area_nm, atol=1e-6)
    for name, at in plain.fixes_nm.items():
        assert np.allclose(shifted.fixes_nm[name], at, atol=1e-6)
    assert np.allclose(shifted.edge_through("EDGED"), plain.edge_through("EDGED"), atol=1e-6)
    assert np.isclose((shifted.origin[1] - plain.origin[1] - lon + 180.0) % 360.0, 180.0)
    for _, east in (*shifted.area, *shifted.fixes.values(), shifted.origin):
        assert -180.0 <= east < 180.0


def test_reads_separation_standards(tmp_path):
    sector = read(PLAIN | {"separation_nm": 3.0, "separation_fl": 20}, tmp_path)
    assert (sector.separation_nm, sector.separation_fl) == (3.0, 20)
    assert sector.loss_below_nm == 2.9995
    plain = read(PLAIN, tmp_path)
    assert (plain.separation_nm, plain.separation_fl) == (5.0, 10)


def test_accepts_whole_numbers_with_a_decimal_point(tmp_path):
    assert read(PLAIN | {"levels_fl": [200.0, 4e2]}, tmp_path).levels_fl == (200, 400)


@pytest.mark.parametrize(("south", "west"), [(63.4, 10.0), (-38.5, 144.0), (-2.0, -178.0)])
def test_sectors_400_nm_across_keep_their_size(south, west, tmp_path):
    """Its area and lengths agree with pyproj."""
    wide = 6.7 / np.cos(np.radians(south + 3.3))
    ring = [[west, south], [west + wide, south], [west + wide, south + 6.6], [west, south + 6.6]]
    fixes = {
        "WESTO": {"lat": south + 2.0, "lon": west - 0.3},
        "EASTE": {"lat": south + 2.0, "lon": west + wide},
        "EASTO": {"lat": south + 2.0, "lon": west + wide + 0.3},
    }
    area = {"type": "Polygon", "coordinates": [ring]}
    entry = PLAIN | {"area": area, "fixes": fixes, "routes": [["WESTO", "EASTE", "EASTO"]]}
    sector = read(entry, tmp_path)
    x, y = sector.area_nm.T
    plane_area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    north = np.linspace(y.min(), y.max(), 2001)
    middle = (north[1:] + north[:-1]) / 2.0
    strips = (x.max() - x.min()) * np.diff(north) / sector.plane.scale(middle) ** 2
    parallel = np.linspace(west, west + wide, 2001)
    lon = np.concatenate([parallel, parallel[::-1]])
    lat = np.repeat([south, south + 6.6], 2001)
    geodesic_m2 = WGS84.polygon_area_perimeter(lon, lat)[0]
    assert plane_area == pytest.approx((x.max() - x.min()) * (y.max() - y.min()), rel=1e-6)
    assert strips.sum() * METRES_PER_NM**2 == pytest.approx(geodesic_m2, rel=1e-4)
    leg = geodesic_leg(sector.fixes["EASTE"], sector.fixes["EASTO"])[1]
    assert sector.route_table.leg_nm[0, 1] == pytest.approx(leg, rel=1e-6)


def test_reads_the_area_from_a_file_in_the_same_folder(tmp_path):
    (tmp_path / "area.geojson").write_text(json.dumps(FEATURE))
    assert read(changed(["area"], "area.geojson", PLAIN), tmp_path) == read(PLAIN, tmp_path)


def test_keeps_only_the_polygon_of_an_area(tmp_path):
    """Other members of GeoJSON can have types that configurations do not support."""
    path = tmp_path / "sector.json"
    polygon = PLAIN["area"] | {"remark": [None]}
    feature = {"type": "Feature", "properties": {"tags": [None]}, "geometry": polygon}
    path.write_text(json.dumps(PLAIN | {"area": feature}))
    assert read_sector(path).area == PLAIN["area"]
    with_altitudes = [[*at, 9144.0] for at in SQUARE]
    area = {"type": "MultiPolygon", "coordinates": [[[*with_altitudes[:1], *with_altitudes]]]}
    path.write_text(json.dumps(PLAIN | {"area": area}))
    assert read_sector(path).area == PLAIN["area"]


@pytest.mark.parametrize("name", ["../area.geojson", "/tmp/area.geojson", "area.txt", ""])
def test_refuses_files_outside_the_folder(name, tmp_path):
    with pytest.raises(
        InputError, match=r"area: .*: is not allowed \(allowed: the name of a .geojson"
    ):
        read(changed(["area"], name, PLAIN), tmp_path)
    with pytest.raises(InputError, match="is not allowed"):
        find_sector("../sector.json", tmp_path)


def test_find_sector_without_a_folder_reads_any_path(tmp_path):
    path = tmp_path / "sector.json"
    path.write_text(json.dumps(PLAIN))
    assert find_sector(path).fixes == find_sector("sector.json", tmp_path).fixes
    assert find_sector("x-plus") is sector_named("x-plus")


BOW_TIE = [[9.5, 49.5], [10.5, 50.5], [10.5, 49.5], [9.5, 50.5]]
HOLE = [[9.9, 49.9], [10.1, 49.9], [10.1, 50.1]]


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (["name"], "", 'name is "" (allowed: 1 to 40 printable'),
        (["name"], "a\nb", r'name is "a\nb" (allowed: 1 to 40 printable'),
        (["nmae"], "x", "unknown field 'nmae'; did you mean 'name'?"),
        (["levels_fl"], [400, 200], "levels_fl is [400, 200] (allowed: the lowest level"),
        (["levels_fl"], [205, 400], "levels_fl[0] is 205 (allowed: whole number"),
        (["levels_fl"], ..., "levels_fl is missing"),
        (["area"], ..., "area is missing"),
        (["area", "type"], "Point", 'area: its GeoJSON type is "Point" (allowed: Polygon, or'),
        (["area"], 5, "area: its GeoJSON type is 5 (allowed: Polygon, or"),
        (["area"], {"type": "Feature"}, "area: its GeoJSON type is null (allowed: Polygon, or"),
        (
            ["area"],
            {"type": "FeatureCollection", "features": []},
            "area: is a FeatureCollection (allowed: one with exactly one Feature",
        ),
        (["area", "coordinates"], [SQUARE, HOLE], "area: coordinates must contain one ring"),
        (
            ["area", "coordinates"],
            [[[1, "x"]]],
            'area: coordinates[0][0] is [1, "x"] (allowed: [longitude',
        ),
        (
            ["area"],
            {"type": "MultiPolygon", "coordinates": [[SQUARE], [HOLE]]},
            "area: is a MultiPolygon of 2 separate polygons (allowed: one polygon, or one area",
        ),
        (
            ["area"],
            {"type": "MultiPolygon", "coordinates": []},
            "area: coordinates has no polygon (allowed: a MultiPolygon of one",
        ),
        (
            ["area", "coordinates", 0, 1],
            [10.5, 76.0],
            "area: coordinates[0][1] is [10.5, 76] (allowed: [longitude, latitude], from -360",
        ),
        (["area", "coordinates", 0, 1], [10.5], "area: coordinates[0][1] is [10.5] (allowed"),
        (
            ["area", "coordinates"],
            [[[0.0, 60.0], [120.0, 60.0], [-120.0, 60.0]]],
            "area: contains a pole (allowed: an area that does not)",
        ),
        (["separation_nm"], 0.0, "separation_nm is 0 (allowed: number from 0.1 to 50)"),
        (["separation_fl"], 10.5, "separation_fl is 10.5 (allowed: whole number from 1 to 100)"),
        (["separation_fl"], "10", 'separation_fl is "10" (allowed: whole number from 1 to 100)'),
        (
            ["levels_fl"],
            [200.5, 400],
            "levels_fl[0] is 200.5 (allowed: whole number from 0 to 600, a multiple of 10)",
        ),
        (["levels_fl"], [1e300, 400], "levels_fl[0] is 1e+300 (allowed: "),
        (
            ["area", "coordinates"],
            [SQUARE[:2]],
            "area: has 2 vertices at least a metre apart (allowed: 3 to 500)",
        ),
        (
            ["area", "coordinates"],
            [BOW_TIE],
            "area: is not a simple polygon: Self-intersection at lat 50.0000, lon 10.0000",
        ),
        (["area", "coordinates", 0, 1], [60.0, 49.5], "area: a vertex is"),
        (["area", "coordinates", 0, 1], [-179.0, 49.5], "area: a vertex is"),
        (
            ["area", "coordinates", 0],
            [at[::-1] for at in SQUARE],
            "fixes.WESTO is 3131 NM from the origin at lat 50.0, lon 9.3 (allowed: at most 400 NM; "
            "are lat and lon swapped?)",
        ),
        (["fixes", "MIDDL", "lat"], 91.0, "fixes.MIDDL.lat is 91 (allowed: number from -75 to 75)"),
        (["fixes", "MIDDL", "lat"], "x", 'fixes.MIDDL.lat is "x" (allowed: number from -75 to'),
        (["fixes", "MIDDL", "alt"], 3, "fixes.MIDDL: unknown field 'alt'; did you mean 'lat'?"),
        (["fixes", "MIDDL", "lat"], 70.0, "fixes.MIDDL is 1203 NM from the origin"),
        (["fixes", " X"], {"lat": 50.0, "lon": 10.0}, "fixes: ' X' is \" X\" (allowed: 1 to 40"),
        (["routes"], [], "routes is empty"),
        (["routes", 0, 1], "MIDDLE", "routes[0]: unknown fix 'MIDDLE'; did you mean 'MIDDL'?"),
        (["routes"], [["WESTO", "EASTO"]], "routes[0]: the route is"),
        (["routes"], PLAIN["routes"] * 2, "routes[1]: the route is"),
        (
            ["fixes", "EDGED", "lon"],
            10.4,  # a tenth of a degree inside: 6.01 NM times the cosine of 50 degrees
            "routes[0]: its exit fix EDGED is not on an edge of the area; lat 50.0000, lon 10.5000 "
            "is, 3.87 NM away",
        ),
        (["fixes", "EDGED", "lat"], 50.4999, "routes[0]: its exit fix EDGED is not on an edge"),
        (["fixes", "EASTO", "lon"], 10.49, "routes[0]: ends at EASTO, 0.39 NM inside the area"),
        (
            ["routes"],
            [["WESTO", "EDGED", "MIDDL", "EASTO"]],
            "routes[0]: leaves the area after MIDDL without an exit fix",
        ),
        (["fixes", "MIDDL"], {"lat": 50.0, "lon": 9.3}, "routes[0]: the route is"),
        (
            ["fixes", "EASTO"],
            {"lat": 51.0, "lon": 10.2},
            "routes[0]: the leg after its exit fix EDGED does not leave the area across the edge",
        ),
        (
            ["area", "coordinates", 0],  # at the exit, an edge of 0.015 degrees of the meridian
            [*SQUARE[:2], [10.5, 49.9925], [10.5, 50.0075], *SQUARE[2:]],
            "routes[0]: its exit fix EDGED is nearest to an edge of 0.90 NM (allowed: an edge of "
            "more",
        ),
    ],
)
def test_refuses_an_invalid_sector_in_one_line(where, value, message, tmp_path):
    with pytest.raises(InputError) as error:
        read(changed(where, value, PLAIN), tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'sector.json'}: {message}")
    assert "\n" not in str(error.value)


def test_reads_the_example_across_the_antimeridian():
    """A split MultiPolygon with altitudes and a repeated vertex. Its area is that by pyproj."""
    folder = EXAMPLES / "antimeridian"
    sector = make_sector(read_sector(folder / "sector.json"))
    parts = json.loads((folder / "area.geojson").read_text())["features"][0]["geometry"]
    rings = [np.array(polygon[0])[:, :2] for polygon in parts["coordinates"]]
    parts_m2 = sum(abs(WGS84.polygon_area_perimeter(*ring.T)[0]) for ring in rings)
    lat, lon = np.array(sector.area).T
    assert abs(WGS84.polygon_area_perimeter(lon, lat)[0]) == pytest.approx(parts_m2, rel=1e-3)
    # 8 vertices in the west and 6 in the east, without the split and the repeated vertex.
    assert len(sector.area) == 14
    assert not np.any(np.abs(lon) == 180.0)
    # RABIX, on the antimeridian, lies on an edge that crosses it.
    ends = sector.plane.to_degrees(sector.edge_through("RABIX")[[0, -1]])
    assert np.allclose(ends, [[-16.16, -179.3], [-15.7, 179.3]], atol=1e-6)


@pytest.mark.parametrize("name", sector_names())
def test_shipped_sectors_are_valid(name):
    """By shapely: a simple polygon, routes that end outside, exit fixes on the edge."""
    sector = sector_named(name)
    assert sector.name == name
    area = shapely.Polygon(sector.area_nm)
    in_degrees = shapely.Polygon(sector.area)  # where its edges are straight
    assert area.is_valid
    for route in sector.routes:
        at = {fix: shapely.Point(sector.fixes_nm[fix]) for fix in route}
        assert area.distance(at[route[0]]) > 4.0  # the disc of starts lies outside
        assert area.distance(at[route[-1]]) > 4.0
        assert in_degrees.exterior.distance(shapely.Point(sector.fixes[route[-2]])) < 0.01 / 60.0
        assert len(set(route)) == len(route) >= 3


@pytest.mark.slow
@given(
    lat=st.floats(-70.0, 70.0),
    lon=st.floats(-170.0, 170.0),
    corners=st.integers(3, 40),
    radius_nm=st.floats(20.0, 100.0),
    clockwise=st.booleans(),
)
def test_a_regular_polygon_anywhere_keeps_its_size(lat, lon, corners, radius_nm, clockwise):
    """Its area in the plane is that of the closed form."""
    plane = MercatorPlane(lat, lon)
    turn = 2.0 * np.pi * np.arange(corners) / corners
    ring = radius_nm * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    def place(east, north):
        at = plane.to_degrees(np.array([east, north]))
        return {"lat": float(at[0]), "lon": float(at[1])}

    # The exit lies in the middle of the edge from the first corner to the second.
    middle = ring[:2].mean(axis=0)
    degrees = [list(map(float, at[::-1])) for at in plane.to_degrees(ring)]
    entry = {
        "name": "round",
        "levels_fl": [0, 600],
        "origin": {"lat": lat, "lon": lon},
        "area": {"type": "Polygon", "coordinates": [degrees[:: -1 if clockwise else 1]]},
        "fixes": {
            "IN": place(*(-1.5 * ring[0])),
            "X": place(*middle),
            "OUT": place(*(1.2 * middle)),
        },
        "routes": [["IN", "X", "OUT"]],
    }
    if corners == 3:
        entry["fixes"]["IN"] = place(*(-3.0 * middle))
    sector = make_sector(msgspec.convert(entry, SectorEntry))
    area = 0.5 * corners * radius_nm**2 * np.sin(2.0 * np.pi / corners)
    # Edges are straight in degrees, not in the plane.
    assert np.isclose(shapely.Polygon(sector.area_nm).area, area, rtol=5e-3)
    assert shapely.LinearRing(sector.area_nm).is_ccw
    assert np.allclose(sector.edge_through("X")[[0, -1]], ring[:2], atol=1e-6)


@pytest.mark.parametrize(
    ("fixes", "routes", "inner", "message"),
    [
        (1001, 1, 1, r"sector.json: fixes has 1001 entries \(allowed: at most 1000\)"),
        (4, 201, 1, r"sector.json: routes has 201 entries \(allowed: at most 200\)"),
        (5, 1, 98, r"sector.json: routes\[0\]: the route has 101 entries \(allowed: at most 100\)"),
        (1000, 1, 97, None),
    ],
)
def test_limits_the_numbers_of_fixes_and_routes(fixes, routes, inner, message, tmp_path):
    spare = {f"S{n}": {"lat": 50.0, "lon": 10.1} for n in range(fixes - 4)}
    route = ["WESTO", *[("MIDDL", "S0")[n % 2] for n in range(inner)], "EDGED", "EASTO"]
    crowded = PLAIN | {"fixes": PLAIN["fixes"] | spare, "routes": [route] * routes}
    if message is None:
        assert len(read(crowded, tmp_path).routes[0]) == 100
        return
    with pytest.raises(InputError, match=message):
        read(crowded, tmp_path)


def test_refuses_an_area_whose_edges_cross_only_in_the_plane():
    """The second vertex lies almost exactly on the edge from the third to the fourth. Edges are
    straight in degrees and bend in the plane, where two of these cross."""
    ring = [(7.2, 45.7), (8.2, 45.6), (8.0, 45.5), (9.0, 46.0), (8.4, 46.3), (7.2, 46.1)]
    area = {"type": "Polygon", "coordinates": [[list(each) for each in (*ring, ring[0])]]}
    entry = msgspec.structs.replace(
        read_sector(EXAMPLES / "own-sector" / "valley.json"), area=area, origin=None
    )
    with pytest.raises(InputError, match="area: is not a simple polygon"):
        make_sector(entry)
