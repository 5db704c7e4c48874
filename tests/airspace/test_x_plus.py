"""The generated X-Plus sector against the published values of BluebirdDT.

Points of the layout are NM at 60 NM per degree; legs and bearings are WGS-84 geodesics.
"""

from itertools import pairwise

import numpy as np
import pytest
from shapely.geometry import LineString, Point, Polygon

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import turns_deg
from skystack.airspace.xplus import XPlus, x_plus

FIXES_LAT_LON = {
    "EGL": (0.0, 0.0),
    "QUAIL": (0.707106781187, 0.707106781187),
    "SWIFT": (0.766032346285, 0.766032346285),
    "GOOSE": (0.589255650989, -0.589255650989),
    "PEL": (0.648181216088, -0.648181216088),
    "CRANE": (-0.353553390593, -0.353553390593),
    "HERON": (-0.412478955692, -0.412478955692),
    "FINCH": (-0.194114283827, 0.724444369717),
    "ROBIN": (-0.215682537585, 0.804938188574),
    "ALB": (0.245812289025, -0.245812289025),
    "MACAW": (0.245812289025, 0.245812289025),
}
FIXES_LAYOUT_NM = {
    "EGL": (0.0, 0.0),
    "QUAIL": (42.426406871, 42.426406871),
    "SWIFT": (45.961940777, 45.961940777),
    "GOOSE": (-35.355339059, 35.355339059),
    "PEL": (-38.890872965, 38.890872965),
    "CRANE": (-21.213203436, -21.213203436),
    "HERON": (-24.748737342, -24.748737342),
    "FINCH": (43.466662183, -11.646857030),
    "ROBIN": (48.296291314, -12.940952255),
    "ALB": (-14.748737342, 14.748737342),
    "MACAW": (14.748737342, 14.748737342),
}
AREA_LAYOUT_NM = [
    (-28.284271, -14.142136),
    (-14.142136, -28.284271),
    (0.0, -14.142136),
    (2.988585, -11.153551),
    (40.878472, -21.306115),
    (46.054853, -1.987599),
    (19.318517, 5.176381),
    (49.497475, 35.355339),
    (35.355339, 49.497475),
    (10.606602, 24.748737),
    (-10.606602, 24.748737),
    (-28.284271, 42.426407),
    (-42.426407, 28.284271),
    (-14.142136, 0.0),
]
# Route: geodesic legs [NM], their sum in the layout [NM], turns at the inner fixes [deg, + right],
# first heading [deg].
ROUTES = {
    "ROBIN FINCH EGL CRANE HERON": (
        (5.0067, 45.0606, 29.9533, 4.9922),
        85.0,
        (0.0, -59.711, 0.0),
        284.9040,
    ),
    "ROBIN FINCH EGL ALB GOOSE PEL": (
        (5.0067, 45.0606, 20.8255, 29.0965, 4.9921),
        105.0,
        (0.0, 29.905, 0.0, 0.0),
        284.9040,
    ),
    "HERON CRANE EGL MACAW QUAIL SWIFT": (
        (4.9922, 29.9533, 20.8255, 39.0807, 4.9920),
        100.0,
        (0.0, 0.0, 0.0, 0.0),
        45.1920,
    ),
    "HERON CRANE EGL FINCH ROBIN": (
        (4.9922, 29.9533, 45.0606, 5.0067),
        85.0,
        (0.0, 59.712, 0.0),
        45.1920,
    ),
    "PEL GOOSE ALB MACAW QUAIL SWIFT": (
        (4.9921, 29.0965, 29.5502, 39.0807, 4.9920),
        107.7817,
        (0.0, -44.808, -44.809, 0.0),
        134.8089,
    ),
    "PEL GOOSE ALB EGL MACAW QUAIL SWIFT": (
        (4.9921, 29.0965, 20.8255, 20.8255, 39.0807, 4.9920),
        120.0,
        (0.0, 0.0, -89.615, 0.0, 0.0),
        134.8089,
    ),
    "PEL GOOSE ALB EGL FINCH ROBIN": (
        (4.9921, 29.0965, 20.8255, 45.0606, 5.0067),
        105.0,
        (0.0, 0.0, -29.903, 0.0),
        134.8089,
    ),
    "SWIFT QUAIL MACAW EGL CRANE HERON": (
        (4.9920, 39.0807, 20.8255, 29.9533, 4.9922),
        100.0,
        (0.0, 0.0, 0.0, 0.0),
        225.1904,
    ),
    "SWIFT QUAIL MACAW EGL ALB GOOSE PEL": (
        (4.9920, 39.0807, 20.8255, 20.8255, 29.0965, 4.9921),
        120.0,
        (0.0, 0.0, 89.615, 0.0, 0.0),
        225.1904,
    ),
    "SWIFT QUAIL MACAW ALB GOOSE PEL": (
        (4.9920, 39.0807, 29.5502, 29.0965, 4.9921),
        107.7817,
        (0.0, 44.807, 44.808, 0.0),
        225.1904,
    ),
}
EDGE_FIXES = ("QUAIL", "GOOSE", "CRANE", "FINCH")
OUTER_FIXES = ("SWIFT", "PEL", "HERON", "ROBIN")
# The end of each arm, counter-clockwise, from the vertices above.
ARM_ENDS_LAYOUT_NM = {
    "QUAIL": ((49.497475, 35.355339), (35.355339, 49.497475)),
    "GOOSE": ((-28.284271, 42.426407), (-42.426407, 28.284271)),
    "CRANE": ((-28.284271, -14.142136), (-14.142136, -28.284271)),
    "FINCH": ((40.878472, -21.306115), (46.054853, -1.987599)),
}


def test_fixes_have_the_published_positions():
    sector = x_plus()
    assert set(sector.fixes) == set(FIXES_LAT_LON)
    for name, point in FIXES_LAT_LON.items():
        assert sector.fixes[name] == pytest.approx(point, abs=1e-11)


def test_layout_has_60_nm_per_degree():
    layout = XPlus().fixes_layout_nm()
    for name, point in FIXES_LAYOUT_NM.items():
        assert layout[name] == pytest.approx(point, abs=1e-8)
        assert np.array(FIXES_LAT_LON[name])[::-1] * 60.0 == pytest.approx(point, abs=1e-8)


def test_area_has_the_fourteen_vertices_counter_clockwise():
    area = XPlus().area_layout_nm()
    shift = int(np.argmin(np.linalg.norm(area - AREA_LAYOUT_NM[0], axis=1)))
    assert np.roll(area, -shift, axis=0) == pytest.approx(np.array(AREA_LAYOUT_NM), abs=1e-6)


def test_area_in_degrees_is_the_layout_over_60():
    sector = x_plus()
    expected = XPlus().area_layout_nm()[:, ::-1] / 60.0
    assert np.array(sector.area) == pytest.approx(expected, abs=1e-12)


def test_size_of_the_area():
    area = Polygon(XPlus().area_layout_nm())
    west, south, east, north = area.bounds
    assert area.area == pytest.approx(3381.56, abs=5e-3)
    assert (east - west, north - south) == pytest.approx((91.924, 77.782), abs=5e-4)
    assert x_plus().levels_fl == (200, 400)


def test_has_the_ten_published_routes():
    assert {" ".join(route) for route in x_plus().routes} == set(ROUTES)


@pytest.mark.parametrize("route", ROUTES)
def test_legs_turns_and_first_heading(route):
    sector = x_plus()
    names = tuple(route.split())
    legs_nm, layout_nm, turns, first_heading = ROUTES[route]
    geodesics = [geodesic_leg(sector.fixes[a], sector.fixes[b]) for a, b in pairwise(names)]
    assert [length for _, length in geodesics] == pytest.approx(legs_nm, abs=6e-5)
    assert turns_deg(names, sector.fixes) == pytest.approx(turns, abs=6e-3)
    assert sector.first_heading_deg(names) == pytest.approx(first_heading, abs=6e-5)
    assert LineString([FIXES_LAYOUT_NM[n] for n in names]).length == pytest.approx(
        layout_nm, abs=1e-3
    )


@pytest.mark.parametrize(
    ("max_turn_deg", "additional"),
    [
        (
            91.0,
            {
                "PEL GOOSE ALB EGL CRANE HERON": 90.385,
                "HERON CRANE EGL ALB GOOSE PEL": -90.385,
            },
        ),
        (
            121.0,
            {
                "PEL GOOSE ALB EGL CRANE HERON": 90.385,
                "HERON CRANE EGL ALB GOOSE PEL": -90.385,
                "ROBIN FINCH EGL MACAW QUAIL SWIFT": 120.289,
                "SWIFT QUAIL MACAW EGL FINCH ROBIN": -120.288,
            },
        ),
    ],
)
def test_a_wider_turn_limit_keeps_more_routes(max_turn_deg, additional):
    sector = XPlus(max_turn_deg=max_turn_deg).sector()
    assert {" ".join(route) for route in sector.routes} == {*ROUTES, *additional}
    for route, sharpest in additional.items():
        turns = turns_deg(tuple(route.split()), sector.fixes)
        assert max(turns, key=abs) == pytest.approx(sharpest, abs=2e-3)


EXETER = XPlus(origin=(50.716667, -3.533333), levels_fl=(200, 300))
EXETER_LAT_LON = {
    "EGL": (50.716667, -3.533333),
    "QUAIL": (51.423773781187, -2.416535447460),
    "PEL": (51.364848216088, -4.557064089829),
    "CRANE": (50.363113609407, -4.091731776270),
    "ROBIN": (50.500984462414, -2.262021476955),
}


def test_layout_keeps_its_shape_at_other_origins():
    """BluebirdDT's "xplus" airspace round Exeter: a degree of longitude is 60 NM cos(latitude)."""
    fixes = EXETER.sector().fixes
    for name, point in EXETER_LAT_LON.items():
        assert fixes[name] == pytest.approx(point, abs=1e-9)


def test_exeter_has_one_more_route():
    routes = {" ".join(route) for route in EXETER.sector().routes}
    assert routes == {*ROUTES, "HERON CRANE EGL ALB GOOSE PEL"}


@pytest.mark.parametrize("fix", EDGE_FIXES)
def test_exit_fixes_lie_on_the_edge(fix):
    edge = LineString(ARM_ENDS_LAYOUT_NM[fix])
    point = Point(XPlus().fixes_layout_nm()[fix])
    assert Polygon(XPlus().area_layout_nm()).exterior.distance(point) < 1e-9
    assert edge.interpolate(0.5, normalized=True).distance(point) < 1e-5


@pytest.mark.parametrize(("outer", "edge"), list(zip(OUTER_FIXES, EDGE_FIXES, strict=True)))
def test_outer_fixes_lie_5_nm_outside(outer, edge):
    layout = XPlus().fixes_layout_nm()
    area = Polygon(XPlus().area_layout_nm())
    assert not area.contains(Point(layout[outer]))
    assert area.distance(Point(layout[outer])) == pytest.approx(5.0, abs=1e-9)
    assert Point(layout[outer]).distance(Point(layout[edge])) == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize("fix", OUTER_FIXES)
def test_a_disc_of_4_nm_round_a_first_fix_stays_outside(fix):
    sector = x_plus()
    assert Polygon(sector.area_nm).distance(Point(sector.fixes_nm[fix])) > 4.9


def test_exit_edges_are_arm_ends_with_the_inside_to_the_left():
    sector = x_plus()
    for route, edge in zip(sector.routes, sector.route_table.exit_edge_nm, strict=True):
        lon, lat = np.array(ARM_ENDS_LAYOUT_NM[route[-2]]).T / 60.0
        expected = sector.plane.to_plane(lat, lon)
        assert edge == pytest.approx(expected, abs=1e-5)
        (ax, ay), (bx, by) = edge

        def left_of_edge(point, ax=ax, ay=ay, bx=bx, by=by):
            return (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax)

        assert left_of_edge(sector.fixes_nm["EGL"]) > 0.0
        assert left_of_edge(sector.fixes_nm[route[-1]]) < 0.0


@pytest.mark.parametrize("rotation_deg", [0.0, 30.0, -100.0])
def test_rotation_turns_the_layout_clockwise(rotation_deg):
    turned, upright = XPlus(rotation_deg=rotation_deg), XPlus(rotation_deg=0.0)
    angle = np.radians(rotation_deg)
    clockwise = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    for name, point in upright.fixes_layout_nm().items():
        assert turned.fixes_layout_nm()[name] == pytest.approx(clockwise @ point, abs=1e-9)
    assert turned.area_layout_nm() == pytest.approx(
        upright.area_layout_nm() @ clockwise.T, abs=1e-9
    )


def test_arms_have_the_lengths_of_the_paper():
    layout = XPlus(rotation_deg=0.0).fixes_layout_nm()
    assert layout["QUAIL"] == pytest.approx((0.0, 60.0), abs=1e-9)
    assert layout["GOOSE"] == pytest.approx((-50.0, 0.0), abs=1e-9)
    assert layout["CRANE"] == pytest.approx((0.0, -30.0), abs=1e-9)
    assert np.linalg.norm(layout["FINCH"]) == pytest.approx(45.0)
    assert np.linalg.norm(layout["ALB"]) == pytest.approx(20.857864, abs=1e-6)
    assert np.linalg.norm(layout["MACAW"]) == pytest.approx(20.857864, abs=1e-6)
