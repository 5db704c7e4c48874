"""The Mercator plane against geodesics of the WGS-84 ellipsoid (pyproj)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from skystack.airspace.projection import (
    SCALE_RANGE_NM,
    MercatorPlane,
    geodesic_leg,
    wrap_longitude,
)

GEOD = Geod(ellps="WGS84")
EQUATOR = MercatorPlane(0.0, 0.0)
ORIGINS = [(0.0, 0.0), (46.0, 8.0), (65.0, 15.0), (-41.0, 174.5), (-17.7, 180.0), (75.0, -179.9)]
FAR_NM = 250.0
"""Half the width of the largest sector."""


def geodesic(a, b):
    """Bearing [deg] and distance [NM] from points (lat, lon) to others."""
    bearing, _, metres = GEOD.inv(a[..., 1], a[..., 0], b[..., 1], b[..., 0])
    return bearing, metres / 1852.0


def random_points(plane, count, seed=0):
    """Points up to `FAR_NM` (true) east and north of the origin, in the plane."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-FAR_NM, FAR_NM, (count, 2))
    return points * plane.scale(points[:, 1:])


@pytest.mark.parametrize("origin", ORIGINS)
def test_scale_agrees_with_short_geodesics(origin):
    plane = MercatorPlane(*origin)
    points = random_points(plane, 2000)
    step = 1e-3 * np.array([np.sin(np.arange(2000.0)), np.cos(np.arange(2000.0))]).T
    _, true_nm = geodesic(plane.to_degrees(points), plane.to_degrees(points + step))
    assert plane.scale(points[:, 1]) == pytest.approx(1e-3 / true_nm, rel=1e-5)
    assert plane.scale(np.zeros(1)) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("origin", ORIGINS)
def test_slope_is_the_derivative_of_the_scale(origin):
    scale = MercatorPlane(*origin).scale
    north = np.linspace(-0.99 * SCALE_RANGE_NM, 0.99 * SCALE_RANGE_NM, 101)
    change = (scale(north + 0.5) - scale(north - 0.5)) / 1.0
    assert scale.slope(north) == pytest.approx(change, abs=1e-8)


def test_scale_is_constant_beyond_its_range():
    scale = MercatorPlane(75.0, 0.0).scale
    far = scale(np.array([SCALE_RANGE_NM, 1e4, 1e9]))
    assert np.all(far == far[0])
    assert np.isfinite(scale(jnp.asarray([1e30, -1e30]))).all()


@pytest.mark.parametrize("origin", ORIGINS)
def test_plane_directions_are_true_bearings(origin):
    plane = MercatorPlane(*origin)
    points = random_points(plane, 2000)
    angle = np.linspace(0.0, 360.0, 2000)
    ahead = points + 1e-2 * np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))]).T
    bearing, _ = geodesic(plane.to_degrees(points), plane.to_degrees(ahead))
    assert np.max(np.abs((bearing - angle + 180.0) % 360.0 - 180.0)) < 1e-3


@pytest.mark.parametrize("origin", ORIGINS)
def test_separations_below_20_nm_agree_with_geodesics(origin):
    plane = MercatorPlane(*origin)
    points = random_points(plane, 20_000)
    rng = np.random.default_rng(1)
    angle, length = rng.uniform(0.0, 2.0 * np.pi, 20_000), rng.uniform(0.0, 20.0, 20_000)
    offset = length[:, None] * np.array([np.sin(angle), np.cos(angle)]).T
    others = points + offset * plane.scale(points[:, 1:])
    _, true_nm = geodesic(plane.to_degrees(points), plane.to_degrees(others))
    middle = (points[:, 1] + others[:, 1]) / 2.0
    measured = np.linalg.norm(others - points, axis=1) / plane.scale(middle)
    assert np.max(np.abs(measured - true_nm)) < 0.001
    close = true_nm < 6.0
    assert np.max(np.abs(measured - true_nm)[close]) < 5e-5


@pytest.mark.parametrize("kind", ["float32", "float64"])
@pytest.mark.parametrize("origin", ORIGINS)
def test_geodesic_directions_agree_with_pyproj(origin, kind):
    """Up to 700 NM away. In float64, the error is that of the sphere alone."""
    plane = MercatorPlane(*origin)
    for seed in range(0, 8, 2):
        starts, ends = random_points(plane, 5000, seed=seed), random_points(plane, 5000, seed + 1)
        bearing, distance_nm = geodesic(plane.to_degrees(starts), plane.to_degrees(ends))
        with jax.enable_x64(kind == "float64"):
            points = (jnp.asarray(each, dtype=kind) for each in (starts, ends))
            east, north = np.asarray(plane.geodesic_direction(*points)).T
        error = np.degrees(np.arctan2(east, north)) - bearing
        error = np.radians(np.abs((error + 180.0) % 360.0 - 180.0))
        assert np.max(error * distance_nm) < 1.5e-3  # NM off the target


@given(
    st.floats(-75.0, 75.0), st.floats(-180.0, 180.0), st.floats(-5.0, 5.0), st.floats(-10.0, 10.0)
)
def test_projecting_back_returns_the_point(origin_lat, origin_lon, lat_offset, lon_offset):
    plane = MercatorPlane(origin_lat, origin_lon)
    lat, lon = origin_lat + lat_offset, float(wrap_longitude(origin_lon + lon_offset))
    back = plane.to_degrees(plane.to_plane(lat, lon))
    assert back[0] == pytest.approx(lat, abs=1e-9)
    assert abs((back[1] - lon + 180.0) % 360.0 - 180.0) < 1e-9
    assert -180.0 <= back[1] < 180.0


@pytest.mark.parametrize("origin_lon", [180.0, -180.0, 179.5, -179.5])
def test_longitudes_are_taken_the_shorter_way_from_the_origin(origin_lon):
    plane = MercatorPlane(0.0, origin_lon)
    west, east = plane.to_plane([0.0, 0.0], [179.0, -179.0])[:, 0]
    assert east - west == pytest.approx(2.0 * 60.107716411, abs=1e-6)
    assert -180.0 <= plane.to_degrees(plane.to_plane(0.0, 180.0))[1] < 180.0


@given(st.floats(-1e4, 1e4))
def test_wrapped_longitudes_are_in_range_on_the_same_meridian(lon):
    wrapped = float(wrap_longitude(lon))
    assert -180.0 <= wrapped < 180.0
    assert np.sin(np.radians(wrapped)) == pytest.approx(np.sin(np.radians(lon)), abs=1e-9)
    assert np.cos(np.radians(wrapped)) == pytest.approx(np.cos(np.radians(lon)), abs=1e-9)


@pytest.mark.parametrize("lon", [-180.0, -0.1, 0.0, 8.123456789, 179.99999])
def test_longitudes_in_range_stay_unchanged(lon):
    assert float(wrap_longitude(lon)) == lon


@pytest.mark.parametrize(
    ("start", "end"),
    [((59.0, 11.0), (66.0, 19.0)), ((66.0, 179.0), (60.0, -178.0)), ((-70.0, 10.0), (-66.0, 20.0))],
)
def test_densified_edges_are_straight_in_degrees(start, end):
    plane = MercatorPlane((start[0] + end[0]) / 2.0, start[1] + 2.0)
    points = plane.densified(start, end, 0.05)
    assert points[0] == pytest.approx(plane.to_plane(*start), abs=1e-9)
    assert points[-1] == pytest.approx(plane.to_plane(*end), abs=1e-9)
    assert len(points) > 4
    part = np.linspace(0.0, 1.0, 1001)
    lon = start[1] + part * ((end[1] - start[1] + 180.0) % 360.0 - 180.0)
    exact = plane.to_plane(start[0] + part * (end[0] - start[0]), lon)
    # The nearest piece of the polyline to each exact point.
    a, piece = points[:-1, None], np.diff(points, axis=0)[:, None]
    along = np.sum((exact - a) * piece, axis=2) / np.sum(piece * piece, axis=2)
    gap = a + np.clip(along, 0.0, 1.0)[..., None] * piece - exact
    assert np.linalg.norm(gap, axis=2).min(axis=0).max() < 0.05


def test_edges_along_meridians_or_parallels_need_no_points():
    plane = MercatorPlane(62.0, 15.0)
    assert len(plane.densified((59.0, 11.0), (66.0, 11.0), 0.05)) == 2
    assert len(plane.densified((59.0, 11.0), (59.0, 19.0), 0.05)) == 2


def test_accepts_points_of_any_shape():
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
