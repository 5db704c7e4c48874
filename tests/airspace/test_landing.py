"""Routes that end at an airport inside the area."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, Polygon
from shapely.geometry.polygon import orient

from skystack.airspace.landing import LANDING_NM, is_inside, landing_ends, landing_ring
from skystack.airspace.projection import METRES_PER_NM, WGS84
from tests.airspace.test_sector import SQUARE
from tests.sectors import FAR_NORTH

STAR = np.array([(0.0, 3.0), (-1.0, 1.0), (-3.0, 1.0), (-1.5, -0.5), (0.0, -3.0), (2.0, 0.5)])


@given(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))
def test_inside_is_as_in_shapely(east, north):
    assert is_inside(np.array([east, north]), STAR) == Polygon(STAR).contains(Point(east, north))


def test_the_ring_is_just_outside_the_circle_and_clockwise():
    centre = np.array([10.0, -20.0])
    ring = landing_ring(centre, 5.0)
    polygon = Polygon(ring)
    assert ring[0] == pytest.approx(ring[-1])
    assert polygon == orient(polygon, sign=-1.0)
    distance = polygon.exterior.distance(Point(centre))
    assert distance == pytest.approx(5.0)
    assert np.hypot(*(ring - centre).T).max() < 5.1


def test_the_ends_are_right_and_left_of_the_last_leg():
    ends = landing_ends(np.array([1.0, 2.0]), np.array([1.0, -7.0]), 5.0)  # flown to the north
    assert ends == pytest.approx(np.array([[6.0, 2.0], [-4.0, 2.0]]))


ARRIVAL = replace(SQUARE, routes=(("SOUTH", "SDOOR", "MIDDLE"), *SQUARE.routes))


def test_the_exit_of_an_arrival_is_around_its_airport():
    table = ARRIVAL.route_table
    assert table.lands.tolist() == [True, False, False]
    assert table.exit_fix.tolist() == [2, 3, 2]
    lat, lon = ARRIVAL.plane.to_degrees(table.exit_edge_nm[0].astype(np.float64)).T
    metres = WGS84.inv(lon, lat, np.zeros_like(lon), np.zeros_like(lat))[2]
    assert np.all(np.array(metres) / METRES_PER_NM >= LANDING_NM - 0.01)
    assert np.all(np.array(metres) / METRES_PER_NM <= LANDING_NM + 0.15)


def test_other_exits_are_unchanged_by_an_arrival():
    before, after = SQUARE.route_table, ARRIVAL.route_table
    assert np.array_equal(after.exit_ends_nm[1:], before.exit_ends_nm)
    assert np.array_equal(before.exit_ends_nm, before.exit_edge_nm[:, [0, -1]])


@pytest.mark.parametrize("sector", [SQUARE, FAR_NORTH])
def test_the_exit_fix_is_the_first_one_on_an_edge_after_those_inside(sector):
    """Fixes beyond it are outside, whether there is one or more."""
    route = sector.routes[0]
    (lat, lon), (before_lat, before_lon) = sector.fixes[route[-1]], sector.fixes[route[-2]]
    beyond = (2.0 * lat - before_lat, 2.0 * lon - before_lon)
    longer = replace(
        sector,
        fixes={**sector.fixes, "BEYOND": beyond},
        routes=((*route, "BEYOND"), *sector.routes[1:]),
    )
    assert sector.exit_fix(route) == len(route) - 2
    assert longer.exit_fix((*route, "BEYOND")) == len(route) - 2
    assert np.array_equal(longer.route_table.exit_ends_nm[0], sector.route_table.exit_ends_nm[0])
