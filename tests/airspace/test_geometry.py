"""Plane geometry against closed forms, shapely and brute force."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from shapely.geometry import LineString, Point, Polygon

from skystack.airspace import geometry
from skystack.airspace.xplus import x_plus

ANGLES = st.floats(-3600.0, 3600.0, width=32, allow_subnormal=False)
BELOW_MINUS_180 = float(np.nextafter(np.float32(-180.0), np.float32(-200.0)))
COORDINATES = st.integers(-12800, 12800).map(lambda n: n / 128.0)
"""Within 100 NM of the origin, exact in float32 and further apart than rounding errors."""
POINTS = st.tuples(COORDINATES, COORDINATES)


compiled = cache(jax.jit)


def single(function, *arguments):
    """A function of arrays, applied to single values."""
    return float(
        compiled(function)(*(jnp.asarray(a, dtype=jnp.float32)[None] for a in arguments))[0]
    )


def right_of_route(position_nm, fixes_nm):
    """`distance_right_of_route` of points `[n, 2]` and routes `[n, fixes, 2]`."""
    return geometry.distance_right_of_route(position_nm, list(jnp.moveaxis(fixes_nm, 1, 0)))


def turned(points, angle_deg, shift=(0.0, 0.0)):
    """Points turned clockwise about the origin and then moved."""
    angle = np.radians(angle_deg)
    clockwise = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(points) @ clockwise.T + np.asarray(shift)


@pytest.mark.slow
@given(ANGLES)
@example(BELOW_MINUS_180)
@example(-180.0)
@example(180.0)
@example(-540.0)
def test_wrap_180_is_the_same_angle_in_range(angle):
    wrapped = float(geometry.wrap_180(jnp.float32(angle)))
    assert -180.0 <= wrapped < 180.0
    assert abs((wrapped - angle + 180.0) % 360.0 - 180.0) < 1e-3


@given(ANGLES)
@example(-1e-6)
@example(360.0)
def test_wrap_360_is_the_same_angle_in_range(angle):
    wrapped = float(geometry.wrap_360(jnp.float32(angle)))
    assert 0.0 <= wrapped < 360.0
    assert abs((wrapped - angle + 180.0) % 360.0 - 180.0) < 1e-3


@given(st.integers(-720, 720))
def test_whole_degrees_are_wrapped_exactly(angle):
    assert float(geometry.wrap_360(jnp.float32(angle))) == angle % 360
    assert float(geometry.wrap_180(jnp.float32(angle))) == (angle + 180) % 360 - 180


@pytest.mark.parametrize(
    ("heading", "unit"),
    [(0.0, (0, 1)), (90.0, (1, 0)), (180.0, (0, -1)), (270.0, (-1, 0)), (30.0, (0.5, 0.8660254))],
)
def test_directions_are_compass_headings(heading, unit):
    assert geometry.direction(jnp.float32([heading])) == pytest.approx(np.array([unit]), abs=1e-6)


@given(st.floats(0.0, 359.0), st.floats(0.1, 100.0))
def test_bearing_undoes_direction(heading, distance):
    offset = distance * geometry.direction(jnp.float32([heading]))
    back = float(geometry.bearing(offset)[0])
    assert abs((back - heading + 180.0) % 360.0 - 180.0) < 1e-3
    assert -180.0 <= back <= 180.0


def test_bearing_of_a_zero_vector_is_zero():
    assert float(geometry.bearing(jnp.zeros((1, 2)))[0]) == 0.0


def test_cross_is_positive_to_the_left():
    north, west = jnp.array([[0.0, 2.0]]), jnp.array([[-3.0, 0.0]])
    assert float(geometry.cross(north, west)[0]) == 6.0
    assert float(geometry.cross(west, north)[0]) == -6.0


@given(POINTS, st.lists(POINTS, min_size=2, max_size=6, unique=True))
@example((0.0, -5.0), [(0.0, 0.0), (0.0, 10.0)])  # straight behind the first fix
@example((10.0, 20.0), [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])  # straight beyond the last
def test_distance_to_a_route_is_that_to_its_polyline(position, fixes):
    padded = fixes + fixes[-1:] * (6 - len(fixes))
    distance = single(right_of_route, position, padded)
    assert abs(distance) == pytest.approx(LineString(fixes).distance(Point(position)), abs=2e-3)


@pytest.mark.parametrize("route", range(10))
def test_distance_is_correct_all_round_the_end_of_a_route(route):
    """Far from the last fix, the repeated fix must not hide the leg that determines the side."""
    fixes = x_plus().route_table.fixes_nm[route]
    radii, angles = np.meshgrid(np.linspace(1.0, 100.0, 34), np.linspace(0.0, 2.0 * np.pi, 61))
    points = fixes[-1] + np.stack([radii * np.sin(angles), radii * np.cos(angles)], -1)
    points = points.reshape(-1, 2)
    distance = compiled(right_of_route)(
        jnp.asarray(points, dtype=jnp.float32), jnp.broadcast_to(fixes, (len(points), *fixes.shape))
    )
    expected = shapely.distance(shapely.points(points), LineString(fixes))
    assert np.abs(distance) == pytest.approx(expected, abs=1e-3)


@given(POINTS, POINTS, st.floats(0.05, 0.95), st.floats(0.1, 50.0), st.sampled_from([-1.0, 1.0]))
def test_distance_is_positive_right_of_a_leg(start, end, along, offset, side):
    start, end = np.array(start), np.array(end)
    length = np.linalg.norm(end - start)
    assume(length > 1.0)
    unit = (end - start) / length
    right = np.array([unit[1], -unit[0]])
    position = start + along * (end - start) + side * offset * right
    distance = single(right_of_route, position, [start, end])
    assert distance == pytest.approx(side * offset, abs=2e-3)


@given(POINTS, st.lists(POINTS, min_size=3, max_size=3, unique=True))
def test_mirrored_and_reversed_routes_change_only_the_side(position, fixes):
    original = single(right_of_route, position, fixes)
    mirror = np.array([-1.0, 1.0])
    mirrored = single(right_of_route, np.array(position) * mirror, np.array(fixes) * mirror)
    assert abs(mirrored) == pytest.approx(abs(original), abs=1e-5)
    reverse = single(right_of_route, position, fixes[::-1])
    assert abs(reverse) == pytest.approx(abs(original), abs=2e-3)


@given(
    st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)),
    st.floats(0.0, 360.0),
    st.tuples(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0)),
)
def test_distance_is_invariant_to_rotation_and_shift(position, angle, shift):
    fixes = np.array([(-50.0, 0.0), (0.0, 5.0), (20.0, 40.0)])
    original = single(right_of_route, position, fixes)
    assume(abs(original) > 0.01)
    moved = single(
        right_of_route,
        turned(position, angle, shift),
        turned(fixes, angle, shift),
    )
    assert moved == pytest.approx(original, abs=2e-3)


@given(hnp.arrays(np.float32, (20, 2), elements=st.floats(-60.0, 60.0, width=32)))
def test_inside_the_sector_agrees_with_shapely(points):
    area = Polygon(x_plus().area_nm)
    clear = shapely.distance(shapely.points(points), area.exterior) > 1e-3
    inside = geometry.inside_area(jnp.asarray(points), x_plus().area_nm)
    assert np.array_equal(np.asarray(inside)[clear], area.contains(shapely.points(points))[clear])


@given(
    st.lists(st.floats(1.0, 50.0), min_size=7, max_size=7),
    POINTS,
    st.booleans(),
    st.floats(0.0, 360.0),
)
def test_inside_a_star_shaped_area_agrees_with_shapely(radii, point, clockwise, angle):
    bearings = np.linspace(0.0, 2.0 * np.pi, len(radii), endpoint=False)
    corners = np.array(radii)[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    corners = turned(corners[::-1] if clockwise else corners, angle)
    area = Polygon(corners)
    assume(area.exterior.distance(Point(point)) > 1e-3)
    got = geometry.inside_area(jnp.float32([point]), corners)
    assert bool(got[0]) == area.contains(Point(point))


def test_a_ray_through_a_corner_is_counted_once():
    diamond = np.array([(0.0, -10.0), (10.0, 0.0), (0.0, 10.0), (-10.0, 0.0)])
    points = jnp.array([(-20.0, 0.0), (0.0, 0.0), (20.0, 0.0), (-20.0, 10.0), (-20.0, -10.0)])
    inside = geometry.inside_area(points, diamond)
    assert inside.tolist() == [False, True, False, False, False]


@given(POINTS, POINTS, POINTS, POINTS)
def test_crossing_outward_is_an_intersection_from_left_to_right(before, after, start, end):
    assume(start != end and before != after)
    edge, flown = LineString([start, end]), LineString([before, after])
    # Only in general position: no end point lies on the other segment.
    near = [edge.distance(Point(p)) for p in (before, after)]
    near += [flown.distance(Point(p)) for p in (start, end)]
    assume(min(near) > 1e-2)
    (sx, sy), (ex, ey), (bx, by) = start, end, before
    from_left = (ex - sx) * (by - sy) - (ey - sy) * (bx - sx) > 0.0
    got = compiled(geometry.crosses_outward)(
        *(jnp.float32([point]) for point in (before, after, start, end))
    )
    assert bool(got[0]) == (edge.intersects(flown) and from_left)


@pytest.mark.parametrize(
    ("before", "after", "crosses"),
    [
        ((-1.0, 5.0), (1.0, 5.0), True),
        ((1.0, 5.0), (-1.0, 5.0), False),
        ((-1.0, 11.0), (1.0, 11.0), False),
        ((-3.0, 5.0), (-1.0, 5.0), False),
        ((-1.0, 5.0), (0.0, 5.0), False),
        ((0.0, 5.0), (1.0, 5.0), True),
        ((1.0, 5.0), (2.0, 5.0), False),
    ],
)
def test_a_path_crosses_a_northbound_edge_once(before, after, crosses):
    """A path that stops on the edge has not crossed it; a path that starts on it has."""
    got = compiled(geometry.crosses_outward)(
        *(jnp.array([point]) for point in (before, after, (0.0, 0.0), (0.0, 10.0)))
    )
    assert bool(got[0]) is crosses


TIMES = st.integers(0, 640).map(lambda n: n / 128.0)
SPANS = st.tuples(TIMES, TIMES).map(sorted)
OFFSETS = POINTS
SPEEDS = st.integers(-2000, 2000).map(lambda n: n / 128.0)
VELOCITIES = st.tuples(SPEEDS, SPEEDS)


@given(OFFSETS, VELOCITIES, SPANS)
@example((3.0, 4.0), (0.0, 0.0), [0.0, 1.0])
def test_closest_approach_agrees_with_brute_force(offset, velocity, span):
    closest = single(geometry.closest_approach, offset, velocity, *span)
    times = np.linspace(*span, 2001)
    track = np.array(offset) + times[:, None] * np.array(velocity)
    step_nm = np.linalg.norm(velocity) * (span[1] - span[0]) / 2000.0
    brute = np.min(np.linalg.norm(track, axis=1))
    assert brute - step_nm - 1e-3 <= closest <= brute + 1e-3


@given(OFFSETS, VELOCITIES, SPANS)
def test_closest_approach_is_the_distance_to_the_segment_flown(offset, velocity, span):
    ends = [np.array(offset) + t * np.array(velocity) for t in span]
    closest = single(geometry.closest_approach, offset, velocity, *span)
    assert closest == pytest.approx(LineString(ends).distance(Point(0.0, 0.0)), abs=1e-3)


@given(OFFSETS, VELOCITIES, SPANS, st.floats(0.0, 360.0))
def test_closest_approach_is_invariant_to_rotation(offset, velocity, span, angle):
    original = single(geometry.closest_approach, offset, velocity, *span)
    moved = single(geometry.closest_approach, turned(offset, angle), turned(velocity, angle), *span)
    assert moved == pytest.approx(original, abs=1e-3)
    exchanged = single(geometry.closest_approach, -np.array(offset), -np.array(velocity), *span)
    assert exchanged == original


def test_closest_approach_head_on_and_passing():
    closest = compiled(geometry.closest_approach)(
        jnp.array([[10.0, 0.0], [10.0, 3.0], [10.0, 3.0], [10.0, 0.0], [10.0, 3.0]]),
        jnp.array([[-10.0, 0.0], [-10.0, 0.0], [-10.0, 0.0], [10.0, 0.0], [-10.0, 0.0]]),
        jnp.array([0.0, 0.0, 0.0, 0.0, 1.4]),
        jnp.array([2.0, 2.0, 0.5, 2.0, 2.0]),
    )
    assert closest == pytest.approx(
        np.array([0.0, 3.0, np.hypot(5.0, 3.0), 10.0, np.hypot(4.0, 3.0)]), abs=1e-5
    )


def test_a_span_that_ends_before_it_begins_has_no_approach():
    assert single(geometry.closest_approach, (1.0, 0.0), (0.0, 1.0), 1.0, 0.5) == np.inf


@pytest.mark.parametrize("corners", [64, 65, 500])
def test_inside_an_area_of_many_corners(corners):
    """A star against shapely, for unrolled code and for a loop."""
    turn = 2.0 * np.pi * np.arange(corners) / corners
    radius = np.where(np.arange(corners) % 2, 60.0, 45.0)
    star = (radius * np.stack([np.cos(turn), np.sin(turn)])).T
    points = np.random.default_rng(corners).uniform(-65.0, 65.0, (500, 2)).astype(np.float32)
    area = shapely.Polygon(star)
    near = shapely.distance(area.exterior, shapely.points(points.astype(float))) < 1e-3
    expected = shapely.contains_xy(area, *points.T.astype(float))
    found = np.asarray(jax.jit(lambda at: geometry.inside_area(at, star))(jnp.asarray(points)))
    np.testing.assert_array_equal(found[~near], expected[~near])
