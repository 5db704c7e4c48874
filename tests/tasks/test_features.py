"""Every feature against its definition in float64, by numpy, shapely and pyproj's geodesics."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.xplus import x_plus
from skystack.simulator.traffic import start, ticks
from skystack.tasks import features
from skystack.tasks.tracking import Tracker
from tests.sectors import FAR_NORTH
from tests.tasks.memories import with_fields

SECTOR = x_plus()
STRAIGHT = ("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT")
SPEED_KT = 466.0
SLANT = np.array([np.sin(np.radians(60.0)), 0.5])
RIGHT_OF_SLANT = np.array([0.5, -np.sin(np.radians(60.0))])
CORNERS_NM = {
    "SWIFT": [(-10.0, 60.0), (10.0, 60.0)],
    "HERON": [(10.0, -30.0), (-10.0, -30.0)],
    "PEL": [(-50.0, -10.0), (-50.0, 10.0)],
    "ROBIN": [45.0 * SLANT - 10.0 * RIGHT_OF_SLANT, 45.0 * SLANT + 10.0 * RIGHT_OF_SLANT],
}
"""The left and right corners of each exit, as seen by an exiting aircraft, by the last fix beyond.
Points are in the layout before its rotation by 45 degrees."""


def degrees_of(layout_nm):
    """Latitude and longitude of a point of the unrotated layout, at 60 NM per degree."""
    x, y = layout_nm
    half = np.sqrt(0.5)
    return half * (y - x) / 60.0, half * (x + y) / 60.0


def wrap_180(angle_deg):
    return (np.asarray(angle_deg) + 180.0) % 360.0 - 180.0


def bearing_deg(start_nm, end_nm):
    east, north = np.asarray(end_nm) - np.asarray(start_nm)
    return np.degrees(np.arctan2(east, north))


def traffic_of(sector, routes, positions_nm, cleared_deg, actual_deg=0.0, fl=300.0):
    count = len(routes)
    traffic = start(
        jnp.asarray(positions_nm, dtype=jnp.float32),
        jnp.full(count, actual_deg, dtype=jnp.float32),
        jnp.full(count, ticks(fl), dtype=jnp.float32),
        jnp.asarray([sector.routes.index(route) for route in routes], dtype=jnp.int32),
        jnp.full(count, SPEED_KT),
        jnp.zeros(count, dtype=bool),
    )
    cleared = jnp.asarray(np.broadcast_to(cleared_deg, count), dtype=jnp.float32)
    return traffic._replace(cleared_heading_deg=cleared)


def memory_of(sector, traffic, next_fix=None):
    memory = Tracker(sector).begin(traffic, traffic.level_ticks)
    if next_fix is None:
        return memory
    return with_fields(memory, next_fix=jnp.asarray(next_fix, dtype=jnp.int32))


def value(name, sector, traffic, memory):
    return np.asarray(features.FEATURES[name].value(sector, traffic, memory))


@pytest.fixture(scope="module")
def scattered():
    """Two aircraft per route with random positions, cleared headings and next fixes."""
    rng = np.random.default_rng(7)
    routes = [*SECTOR.routes, *SECTOR.routes]
    positions = rng.uniform(-60.0, 60.0, (len(routes), 2)).astype(np.float32).astype(np.float64)
    cleared = rng.uniform(0.0, 360.0, len(routes)).round(1)
    next_fix = [int(rng.integers(1, len(route))) for route in routes]
    traffic = traffic_of(SECTOR, routes, positions, cleared, actual_deg=123.0)
    return routes, positions, cleared, next_fix, traffic, memory_of(SECTOR, traffic, next_fix)


@pytest.mark.parametrize(("name", "ahead"), [("theta_f", 0), ("theta_sf", 1)])
def test_turns_to_fixes_start_at_the_cleared_heading(scattered, name, ahead):
    """The last fix has no subsequent fix, so both features refer to it."""
    routes, positions, cleared, next_fix, traffic, memory = scattered
    fixes = [
        SECTOR.fixes_nm[route[min(number + ahead, len(route) - 1)]]
        for route, number in zip(routes, next_fix, strict=True)
    ]
    turns = [bearing_deg(at, fix) for at, fix in zip(positions, fixes, strict=True)] - cleared
    error = wrap_180(value(name, SECTOR, traffic, memory) - turns)
    np.testing.assert_allclose(error, 0.0, atol=1e-3)
    assert np.all(np.abs(value(name, SECTOR, traffic, memory)) <= 180.0)


@pytest.mark.parametrize(("name", "side"), [("theta_xl", 0), ("theta_xr", 1)])
def test_turns_to_the_corners_of_the_exit(scattered, name, side):
    routes, positions, cleared, _, traffic, memory = scattered
    corners = [SECTOR.plane.to_plane(*degrees_of(CORNERS_NM[route[-1]][side])) for route in routes]
    turns = [bearing_deg(at, corner) for at, corner in zip(positions, corners, strict=True)]
    error = wrap_180(value(name, SECTOR, traffic, memory) - (turns - cleared))
    np.testing.assert_allclose(error, 0.0, atol=1e-2)
    assert np.all(np.abs(value(name, SECTOR, traffic, memory)) <= 180.0)


def test_left_corner_is_to_the_left_from_the_middle():
    routes = [next(route for route in SECTOR.routes if route[-1] == last) for last in CORNERS_NM]
    outwards = [bearing_deg((0.0, 0.0), SECTOR.fixes_nm[last]) % 360.0 for last in CORNERS_NM]
    traffic = traffic_of(SECTOR, routes, np.zeros((len(routes), 2)), outwards)
    memory = memory_of(SECTOR, traffic)
    left = value("theta_xl", SECTOR, traffic, memory)
    right = value("theta_xr", SECTOR, traffic, memory)
    half = np.degrees(np.arctan2(10.0, [60.0, 30.0, 50.0, 45.0]))
    np.testing.assert_allclose(left, -half, atol=0.1)
    np.testing.assert_allclose(right, half, atol=0.1)


def test_distance_from_the_route(scattered):
    routes, positions, _, _, traffic, memory = scattered
    expected = []
    for route, at in zip(routes, positions, strict=True):
        fixes = np.array([SECTOR.fixes_nm[name] for name in route])
        legs = [shapely.LineString(fixes[number : number + 2]) for number in range(len(fixes) - 1)]
        gaps = [leg.distance(shapely.Point(at)) for leg in legs]
        nearest = int(np.argmin(gaps))
        (east, north), (x, y) = fixes[nearest + 1] - fixes[nearest], at - fixes[nearest]
        expected.append(min(gaps) * np.sign(x * north - y * east))
    np.testing.assert_allclose(value("d_c", SECTOR, traffic, memory), expected, atol=0.03)


def test_distance_from_the_leg_to_the_next_fix(scattered):
    routes, positions, _, next_fix, traffic, memory = scattered
    expected = []
    for route, at, number in zip(routes, positions, next_fix, strict=True):
        start, end = (SECTOR.fixes_nm[route[each]] for each in (number - 1, number))
        gap = shapely.LineString([start, end]).distance(shapely.Point(at))
        (east, north), (x, y) = end - start, at - start
        expected.append(gap * np.sign(x * north - y * east))
    np.testing.assert_allclose(value("d_leg", SECTOR, traffic, memory), expected, atol=0.03)


def test_times_turns_and_levels(scattered):
    *_, cleared, _, traffic, memory = scattered
    memory = with_fields(
        memory,
        cycles_since_instruction=jnp.arange(20.0),
        entry_level_ticks=jnp.full(20, ticks(120.0), dtype=jnp.float32),
        exit_level_ticks=jnp.full(20, ticks(250.0), dtype=jnp.float32),
    )
    traffic = traffic._replace(cleared_level_ticks=jnp.full(20, ticks(280.0), dtype=jnp.float32))
    for name in ("delta_t", "delta_t_10"):
        np.testing.assert_array_equal(value(name, SECTOR, traffic, memory), 6.0 * np.arange(20.0))
    error = wrap_180(value("theta_turn", SECTOR, traffic, memory) - (cleared - 123.0))
    np.testing.assert_allclose(error, 0.0, atol=1e-3)
    assert np.all(np.abs(value("theta_turn", SECTOR, traffic, memory)) <= 180.0)
    np.testing.assert_array_equal(value("fl_sx", SECTOR, traffic, memory), 280.0 - 250.0)
    np.testing.assert_array_equal(value("fl_nx", SECTOR, traffic, memory), 120.0 - 250.0)


def geodesic_nm(one, other):
    """Points are (latitude, longitude)."""
    return WGS84.inv(one[1], one[0], other[1], other[0])[2] / METRES_PER_NM


@pytest.mark.parametrize("sector", [SECTOR, FAR_NORTH], ids=lambda sector: sector.name)
def test_distances_are_true_lengths(sector):
    """To the next fix, to the middle of the exit, and along the route, for every next fix."""
    sites = np.array([(0.3, 0.2), (-0.5, 0.7), (0.6, -0.4)]) + sector.origin
    cases = [
        (at, route, next_fix)
        for at in sites
        for route in sector.routes
        for next_fix in range(1, len(route))
    ]
    points, routes, next_fixes = zip(*cases, strict=True)
    positions = sector.plane.to_plane(*np.array(points).T)
    traffic = traffic_of(sector, routes, positions, 0.0)
    memory = memory_of(sector, traffic, next_fixes)
    memory = with_fields(memory, exit_level_ticks=memory.plan.exit_level_ticks - ticks(50.0))
    to_fix, to_exit, in_hand = [], [], []
    for at, route, next_fix in cases:
        middle = sector.edge_through(route[-2])[[0, -1]].mean(axis=0)
        names = route[next_fix:-1]
        legs = [
            geodesic_nm(sector.fixes[one], sector.fixes[other]) for one, other in pairwise(names)
        ]
        to_fix.append(geodesic_nm(at, sector.fixes[route[next_fix]]))
        to_exit.append(geodesic_nm(at, sector.plane.to_degrees(middle)))
        # 50 levels at 20 a minute take 2.5 minutes.
        in_hand.append((to_fix[-1] + sum(legs) if names else 0.0) - 2.5 / 60.0 * SPEED_KT)
    for name, expected, within in (
        ("d_f", to_fix, 0.02),
        ("d_x", to_exit, 0.02),
        ("d_xfl", in_hand, 0.05),
    ):
        found = value(name, sector, traffic, memory)
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=within, err_msg=name)


AREA_NM = np.array([SECTOR.plane.to_plane(*point) for point in SECTOR.area])


def first_crossing_nm(at, heading_deg, gate=None):
    """The distance to where a ray first leaves the area (through a gate, if given), at most 100."""
    steps_nm = np.arange(0.0, 100.0, 0.005)
    angle = np.radians(heading_deg)
    points = np.asarray(at) + steps_nm[:, None] * [np.sin(angle), np.cos(angle)]
    inside = shapely.contains_xy(shapely.Polygon(AREA_NM), points)
    leaves = np.flatnonzero(inside[:-1] & ~inside[1:])
    if gate is not None:
        line = shapely.LineString(gate)
        leaves = leaves[shapely.distance(line, shapely.points(points[leaves])) < 0.02]
    return steps_nm[leaves[0]] if leaves.size else 100.0


def test_room_is_exit_distance_minus_edge_distance():
    """Rays are followed in small steps, from inside and outside the area, in all directions."""
    rng = np.random.default_rng(3)
    routes, positions, cleared, expected = [], [], [], []
    for number in range(60):
        route = SECTOR.routes[number % len(SECTOR.routes)]
        at = rng.uniform(-45.0, 45.0, 2)
        gate = [SECTOR.plane.to_plane(*degrees_of(corner)) for corner in CORNERS_NM[route[-1]]]
        towards = bearing_deg(at, np.mean(gate, axis=0)) % 360.0
        heading = [towards, towards + rng.uniform(-25.0, 25.0), rng.uniform(0.0, 360.0)][number % 3]
        if min(abs(wrap_180(heading - bearing_deg(at, corner))) for corner in gate) < 0.5:
            continue  # a ray through a corner may go either way
        routes.append(route)
        positions.append(at)
        cleared.append(heading)
        expected.append(first_crossing_nm(at, heading, gate) - first_crossing_nm(at, heading))
    traffic = traffic_of(SECTOR, routes, positions, cleared)
    found = value("room", SECTOR, traffic, memory_of(SECTOR, traffic))
    kinds = [np.isclose(expected, 0.0, atol=0.02), np.greater(expected, 5.0)]
    assert [int(kind.sum()) >= 10 for kind in kinds] == [True, True]
    np.testing.assert_allclose(found, expected, atol=0.06)


def test_the_distance_ahead_is_that_to_the_first_edge_crossed():
    rng = np.random.default_rng(5)
    positions = rng.uniform(-45.0, 45.0, (40, 2))
    headings = rng.uniform(0.0, 360.0, 40)
    routes = [SECTOR.routes[number % len(SECTOR.routes)] for number in range(40)]
    traffic = traffic_of(SECTOR, routes, list(positions), list(headings))
    found = value("d_edge", SECTOR, traffic, memory_of(SECTOR, traffic))
    rays = zip(positions, headings, strict=True)
    expected = [first_crossing_nm(at, heading) for at, heading in rays]
    assert np.sum(np.less(expected, 100.0)) > 10
    np.testing.assert_allclose(found, expected, atol=0.06)


def test_room_is_measured_within_100_nm_of_true_length():
    """An edge is one degree to the west, without an exit. The plane is stretched by 8 % there."""
    lat, lon = 65.8, 10.0
    route = FAR_NORTH.routes[0]
    traffic = traffic_of(FAR_NORTH, [route], [FAR_NORTH.plane.to_plane(lat, lon)], 270.0)
    found = value("room", FAR_NORTH, traffic, memory_of(FAR_NORTH, traffic))
    edge_nm = geodesic_nm((lat, lon), (lat, 9.0))
    np.testing.assert_allclose(found, 100.0 - edge_nm, atol=0.05)
    # The exit is eleven degrees to the east: neither it nor an edge is within 100 NM.
    eastwards = traffic._replace(cleared_heading_deg=jnp.asarray([90.0]))
    assert value("room", FAR_NORTH, eastwards, memory_of(FAR_NORTH, traffic)).tolist() == [0.0]


SCALES = {
    "theta_f": (-180.0, 180.0, 0.5),
    "theta_sf": (-180.0, 180.0, 0.5),
    "d_c": (-100.0, 100.0, 0.5),
    "d_leg": (-100.0, 100.0, 0.5),
    "delta_t": (0.0, 60.0, 1.0),
    "delta_t_10": (0.0, 10.0, 1.0),
    "fl_sx": (-200.0, 200.0, 0.5),
    "fl_nx": (-200.0, 200.0, 0.5),
    "d_xfl": (-100.0, 100.0, 0.5),
    "theta_turn": (-180.0, 180.0, 0.5),
    "d_f": (0.0, 100.0, 0.0),
    "theta_xl": (-180.0, 180.0, 0.5),
    "theta_xr": (-180.0, 180.0, 0.5),
    "d_x": (0.0, 150.0, 0.0),
    "room": (0.0, 100.0, 0.0),
    "d_edge": (0.0, 100.0, 1.0),
}
"""The values scaled to 0 and 1, and the observation of an exited aircraft. Policies were trained on
these."""


def test_observations_are_scaled_to_the_range_of_the_feature(scattered):
    """Aircraft by aircraft. Values beyond the range are clipped, such as a distance of 200 NM."""
    traffic, memory = scattered[-2:]
    far = traffic.position_nm.at[0].set(jnp.asarray([150.0, 140.0]))
    memory = with_fields(memory, cycles_since_instruction=jnp.arange(20.0) / 4.0)
    active = jnp.arange(20) % 4 != 3
    traffic = traffic._replace(position_nm=far, active=active)
    assert set(SCALES) == set(features.FEATURES)
    observed = np.asarray(features.observe(tuple(SCALES), SECTOR, traffic, memory)).reshape(20, -1)
    for column, (name, (low, high, exited)) in enumerate(SCALES.items()):
        scaled = np.clip((value(name, SECTOR, traffic, memory) - low) / (high - low), 0.0, 1.0)
        expected = np.where(active, scaled, exited)
        np.testing.assert_allclose(observed[:, column], expected, atol=1e-6, err_msg=name)
