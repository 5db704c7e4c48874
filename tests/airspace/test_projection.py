"""The tangent plane against geodesics of the WGS-84 ellipsoid (pyproj)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from skystack.airspace.projection import TangentPlane, geodesic_leg
from skystack.airspace.xplus import x_plus

GEOD = Geod(ellps="WGS84")
EQUATOR = TangentPlane(0.0, 0.0)
LATITUDES = st.floats(-0.66, 0.83)
LONGITUDES = st.floats(-0.83, 0.83)
"""A box round the X-Plus sector and its fixes, in degrees."""


def geodesic_nm(a, b):
    return GEOD.inv(a[1], a[0], b[1], b[0])[2] / 1852.0


def test_scales_at_the_equator():
    assert EQUATOR.scale_nm_per_deg == pytest.approx((60.107716411, 59.705332517), abs=1e-8)


@pytest.mark.parametrize("latitude", [-75.0, -33.0, 1.0, 50.716667, 80.0])
def test_scales_are_those_of_short_geodesics(latitude):
    step = 1e-4
    scale = TangentPlane(latitude, 5.0).scale_nm_per_deg
    east = geodesic_nm((latitude, 5.0 - step), (latitude, 5.0 + step)) / (2.0 * step)
    north = geodesic_nm((latitude - step, 5.0), (latitude + step, 5.0)) / (2.0 * step)
    assert scale == pytest.approx((east, north), rel=1e-7)


@given(LATITUDES, LONGITUDES, LATITUDES, LONGITUDES)
def test_distances_over_the_sector_are_geodesic_within_0_02_nm(lat1, lon1, lat2, lon2):
    first, second = EQUATOR.to_plane([lat1, lat2], [lon1, lon2])
    planar = float(np.linalg.norm(second - first))
    assert planar == pytest.approx(geodesic_nm((lat1, lon1), (lat2, lon2)), abs=0.02)


def test_distances_between_all_vertices_and_fixes():
    sector = x_plus()
    points = np.array([*sector.area, *sector.fixes.values()])
    plane = np.concatenate([sector.area_nm, np.stack(list(sector.fixes_nm.values()))])
    n = len(points)
    first, second = np.triu_indices(n, k=1)
    _, _, metres = GEOD.inv(
        points[first, 1], points[first, 0], points[second, 1], points[second, 0]
    )
    planar = np.linalg.norm(plane[first] - plane[second], axis=1)
    assert np.max(np.abs(planar - metres / 1852.0)) < 0.02


@given(st.floats(-85.0, 85.0), st.floats(-179.0, 179.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_there_and_back(origin_lat, origin_lon, lat_offset, lon_offset):
    plane = TangentPlane(origin_lat, origin_lon)
    point = (origin_lat + lat_offset, origin_lon + lon_offset)
    assert plane.to_degrees(plane.to_plane(*point)) == pytest.approx(point, abs=1e-11)


def test_axes_point_east_and_north():
    east, north = EQUATOR.to_plane([0.0, 1.0], [1.0, 0.0])
    assert east == pytest.approx((60.107716411, 0.0), abs=1e-8)
    assert north == pytest.approx((0.0, 59.705332517), abs=1e-8)


def test_any_shape_of_points():
    points = EQUATOR.to_plane(np.zeros((3, 4)), np.ones((3, 4)))
    assert points.shape == (3, 4, 2)
    assert EQUATOR.to_degrees(points).shape == (3, 4, 2)


@pytest.mark.parametrize(
    ("end", "bearing", "length"),
    [
        ((0.0, 1.0), 90.0, 60.107716411),
        ((0.0, -1.0), 270.0, 60.107716411),
        ((1.0, 0.0), 0.0, 59.705365),
        ((-1.0, 0.0), 180.0, 59.705365),
    ],
)
def test_geodesic_legs_from_the_origin(end, bearing, length):
    leg = geodesic_leg((0.0, 0.0), end)
    assert leg == pytest.approx((bearing, length), abs=5e-5)
    assert 0.0 <= leg[0] < 360.0
