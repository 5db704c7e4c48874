"""Sectors from files: what is read, and what is refused."""

import json

import msgspec
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.projection import TangentPlane, geodesic_leg
from skystack.airspace.sector_file import SectorEntry, make_sector, read_sector
from skystack.airspace.sectors import find_sector, sector_named, sector_names
from skystack.errors import InputError
from tests.scenarios import changed

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


def test_a_file_becomes_a_sector(tmp_path):
    sector = read(PLAIN, tmp_path)
    assert sector.name == "square"
    assert sector.origin == (50.0, 10.0)  # the middle
    assert sector.levels_fl == (200, 400)
    assert sector.fixes["EASTO"] == (50.0, 10.7)
    assert sector.routes == (("WESTO", "MIDDL", "EDGED", "EASTO"),)
    # The exit is the eastern edge, south to north: 1 degree of the meridian, 60 NM of a sphere.
    south, north = sector.edge_through("EDGED")
    length_nm = geodesic_leg((49.5, 10.5), (50.5, 10.5))[1]
    assert np.isclose(north[1] - south[1], length_nm, rtol=1e-4)
    assert south[0] == north[0] > 0.0


FEATURE = {"type": "Feature", "properties": {"name": "any"}, "geometry": PLAIN["area"]}


@pytest.mark.parametrize(
    "area",
    [
        FEATURE,
        {"type": "FeatureCollection", "features": [FEATURE]},
        {"type": "Polygon", "coordinates": [SQUARE[::-1]]},  # clockwise
        {"type": "Polygon", "coordinates": [SQUARE[:-1]]},  # not closed
        {"type": "Polygon", "coordinates": [SQUARE[:2] + SQUARE[1:]]},
    ],
    ids=["feature", "collection", "clockwise", "open", "a vertex twice"],
)
def test_an_area_may_be_written_in_several_ways(area, tmp_path):
    sector, plain = read(changed(["area"], area, PLAIN), tmp_path), read(PLAIN, tmp_path)
    assert sorted(sector.area) == sorted(plain.area)
    assert shapely.LinearRing(sector.area_nm).is_ccw
    assert np.array_equal(sector.edge_through("EDGED"), plain.edge_through("EDGED"))


def test_the_area_may_lie_in_a_file_beside(tmp_path):
    (tmp_path / "area.geojson").write_text(json.dumps(FEATURE))
    assert read(changed(["area"], "area.geojson", PLAIN), tmp_path) == read(PLAIN, tmp_path)


def test_of_an_area_its_polygon_is_kept(tmp_path):
    """GeoJSON may tell anything beside it, in types that a configuration does not have."""
    path = tmp_path / "sector.json"
    polygon = PLAIN["area"] | {"remark": [None]}
    feature = {"type": "Feature", "properties": {"tags": [None]}, "geometry": polygon}
    path.write_text(json.dumps(PLAIN | {"area": feature}))
    assert read_sector(path).area == PLAIN["area"]


@pytest.mark.parametrize("name", ["../area.geojson", "/tmp/area.geojson", "area.txt", ""])
def test_no_name_leads_out_of_the_folder(name, tmp_path):
    with pytest.raises(
        InputError, match=r"area: .*: is not allowed \(allowed: the name of a .geojson"
    ):
        read(changed(["area"], name, PLAIN), tmp_path)
    with pytest.raises(InputError, match="is not allowed"):
        find_sector("../sector.json", tmp_path)


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
        (["area", "type"], "Point", 'area: its GeoJSON type is "Point" (allowed: Polygon)'),
        (["area"], 5, "area: its GeoJSON type is 5 (allowed: Polygon)"),
        (["area"], {"type": "Feature"}, "area: its GeoJSON type is null (allowed: Polygon)"),
        (
            ["area"],
            {"type": "FeatureCollection", "features": []},
            "area: is a FeatureCollection (allowed: of just one",
        ),
        (["area", "coordinates"], [SQUARE, HOLE], "area: coordinates must hold one ring"),
        (["area", "coordinates"], [[[1, "x"]]], "area: coordinates[0] is not a ring"),
        (["area", "coordinates"], [SQUARE[:2]], "area: has 2 vertices (allowed: 3 to 500)"),
        (
            ["area", "coordinates"],
            [BOW_TIE],
            "area: is no plain polygon: Self-intersection at lat 50.0000, lon 10.0000",
        ),
        (["area", "coordinates", 0, 1], [60.0, 49.5], "area: a vertex is"),
        (["area", "coordinates", 0, 1], [-179.0, 49.5], "area: lies on both sides of the 180th"),
        (
            ["area", "coordinates", 0],
            [at[::-1] for at in SQUARE],
            "fixes.WESTO is 3393 NM from the origin at lat 50.0, lon 9.3 (allowed: at most 250 NM; "
            "are they exchanged? GeoJSON has the longitude first)",
        ),
        (["fixes", "MIDDL", "lat"], 91.0, "fixes.MIDDL: lat is 91.0 (allowed: number <= 80.0)"),
        (["fixes", "MIDDL", "lat"], "x", 'fixes.MIDDL: lat is "x" (allowed: number)'),
        (["fixes", "MIDDL", "alt"], 3, "fixes.MIDDL: unknown field 'alt'; did you mean 'lat'?"),
        (["fixes", "MIDDL", "lat"], 70.0, "fixes.MIDDL is 1201 NM from the origin"),
        (["fixes", " X"], {"lat": 50.0, "lon": 10.0}, "fixes: ' X' is \" X\" (allowed: 1 to 40"),
        (["routes"], [], "routes is empty"),
        (["routes", 0, 1], "MIDDLE", "routes[0]: unknown fix 'MIDDLE'; did you mean 'MIDDL'?"),
        (["routes"], [["WESTO", "EASTO"]], "routes[0]: it is"),
        (["routes"], PLAIN["routes"] * 2, "routes[1]: it is"),
        (
            ["fixes", "WESTO", "lon"],
            9.8,
            "routes[0]: starts or ends at WESTO inside the area (allowed: outside)",
        ),
        (
            ["fixes", "EDGED", "lon"],
            10.4,  # a tenth of a degree inside: 6.01 NM times the cosine of 50 degrees
            "routes[0]: its exit EDGED is not on an edge but 3.9 NM off lat 50.0000, lon 10.5000",
        ),
        (["fixes", "EDGED", "lat"], 50.4999, "routes[0]: its exit EDGED is not on an edge"),
        (["fixes", "MIDDL"], {"lat": 50.0, "lon": 9.3}, "routes[0]: it is"),
        (
            ["fixes", "EASTO"],
            {"lat": 51.0, "lon": 10.2},
            "routes[0]: its last leg does not lead out over the edge of EDGED",
        ),
    ],
)
def test_what_is_no_sector_is_refused_in_one_line(where, value, message, tmp_path):
    with pytest.raises(InputError) as error:
        read(changed(where, value, PLAIN), tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'sector.json'}: {message}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", sector_names())
def test_the_sectors_of_the_package_hold_what_a_sector_promises(name):
    """As shapely sees them: a plain polygon, ends outside, the exit fix on its edge."""
    sector = sector_named(name)
    assert sector.name == name
    area = shapely.Polygon(sector.area_nm)
    assert area.is_valid
    for route in sector.routes:
        at = {fix: shapely.Point(sector.fixes_nm[fix]) for fix in route}
        assert area.distance(at[route[0]]) > 4.0  # the disc of starts lies outside
        assert area.distance(at[route[-1]]) > 4.0
        assert area.exterior.distance(at[route[-2]]) < 0.01
        assert len(set(route)) == len(route) >= 3


@given(
    lat=st.floats(-70.0, 70.0),
    lon=st.floats(-170.0, 170.0),
    corners=st.integers(3, 40),
    radius_nm=st.floats(20.0, 100.0),
    clockwise=st.booleans(),
)
def test_a_regular_polygon_anywhere_keeps_its_size(lat, lon, corners, radius_nm, clockwise):
    """Drawn in NM round its origin with pyproj's plane scales; area by the closed form."""
    plane = TangentPlane(lat, lon)
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
    assert np.isclose(shapely.Polygon(sector.area_nm).area, area, rtol=1e-6)
    assert shapely.LinearRing(sector.area_nm).is_ccw
    assert np.allclose(sector.edge_through("X"), ring[:2], atol=1e-6)
