"""Features of aircraft pairs, predicted closest approaches and what they cost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.projection import METRES_PER_NM, WGS84, MercatorPlane
from skystack.simulator.traffic import SHORTEST, start, ticks
from skystack.tasks.conformance import check_task
from skystack.tasks.pairs import PAIR_FEATURES, RANGE_NM, observe_pairs, pair_names, pairs_of
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

from .conftest import REVERSED, STRAIGHT

SPEED_KT = 480.0
PLANE = MercatorPlane(0.0, 0.0)
ROOT_2 = np.sqrt(2.0)


def traffic(positions, headings, speeds=SPEED_KT):
    """Aircraft at positions in true NM, centred on the equator, where the plane's scale is 1."""
    n = len(positions)
    at = np.asarray(positions, dtype=np.float32)
    at[:, 1] -= at[:, 1].mean()
    return start(
        jnp.asarray(at),
        jnp.asarray(headings, dtype=jnp.float32),
        jnp.full(n, ticks(300.0), dtype=jnp.float32),
        jnp.zeros(n, dtype=jnp.int32),
        jnp.asarray(np.broadcast_to(speeds, n), dtype=jnp.float32),
        jnp.zeros(n, dtype=bool),
    )


CASES = {
    "head-on": ([(0, 0), (0, 80)], [0, 180], SPEED_KT, 0.0),
    "head-on, offset by 4 miles": ([(0, 0), (4, 80)], [0, 180], SPEED_KT, 4.0),
    "head-on, too far to meet": ([(0, 0), (0, 400)], [0, 180], SPEED_KT, 100.0),
    "crossing at the same time": ([(-40, 0), (0, -40)], [90, 0], SPEED_KT, 0.0),
    "crossing 10 miles late": ([(-40, 0), (0, -50)], [90, 0], SPEED_KT, 10.0 / ROOT_2),
    "overtaking, offset by 3 miles": ([(0, 0), (3, 20)], [0, 0], [480, 400], 3.0),
    "not yet overtaken": ([(0, 0), (0, 60)], [0, 0], [480, 400], 60.0 - 150.0 / 6.0),
    "diverging": ([(0, 0), (0, 12)], [180, 0], SPEED_KT, 12.0),
    "same track": ([(0, 0), (0, 12)], [0, 0], SPEED_KT, 12.0),
    "same position": ([(0, 0), (0, 0)], [0, 0], SPEED_KT, 0.0),
}


@pytest.mark.parametrize("case", CASES)
def test_predicted_closest_approach(case):
    positions, headings, speeds, expected = CASES[case]
    pairs = pairs_of(PLANE, traffic(positions, headings, speeds))
    assert float(pairs.closest_nm[0]) == pytest.approx(expected, abs=1e-3)


position = st.tuples(st.floats(-60, 60, width=32), st.floats(-60, 60, width=32))
heading = st.floats(0, 359, width=32)


@given(position, position, heading, heading, st.floats(300, 500), st.floats(300, 500))
def test_closest_approach_is_the_minimum_over_time(
    first, second, first_deg, second_deg, first_kt, second_kt
):
    both = traffic([first, second], [first_deg, second_deg], [first_kt, second_kt])
    pairs = pairs_of(PLANE, both)
    times_h = np.linspace(0.0, RANGE_NM / max(first_kt, second_kt), 2001)[:, None]
    offset = np.asarray(pairs.offset_nm, dtype=np.float64)
    distance_nm = np.linalg.norm(offset + times_h * np.asarray(pairs.velocity_kt), axis=1)
    assert float(pairs.closest_nm[0]) == pytest.approx(distance_nm.min(), abs=0.1)
    assert float(pairs.closest_nm[0]) <= distance_nm.min() + 1e-3


def test_predicts_on_the_cleared_headings():
    both = traffic([(0, 0), (0, 80)], [0, 180])
    turned = both._replace(cleared_heading_deg=jnp.array([90.0, 180.0]))
    assert float(pairs_of(PLANE, turned).closest_nm[0]) == pytest.approx(80.0 / ROOT_2, abs=1e-3)


def avoidance(**weights):
    """An avoidance task with the given reward weights only."""
    none = {"centreline": 0.0, "damping": 0.0, "terminal": 0.0}
    return build_task(
        NavigationSettings(
            name="avoidance",
            pair_features=("theta", "d"),
            reward=RewardSettings(**(none | weights)),
        )
    )


@pytest.mark.slow
def test_avoidance_satisfies_the_contract():
    check_task(avoidance(safety=2.0))
    all_features = NavigationSettings(
        name="avoidance", aircraft=4, pair_features=tuple(PAIR_FEATURES)
    )
    check_task(build_task(all_features))


def test_observes_the_ten_values_of_the_paper_in_order(traffic_on):
    task = avoidance()
    assert task.observation_names[-3:] == ("delta_t_2", "theta_12", "d_12")
    assert len(task.observation_names) == 10
    # Head-on, at the south-west and the north-east end of the route.
    state = task.begin(traffic_on(STRAIGHT, REVERSED))
    observation = task.observe(state)
    ends = np.array([task.simulator.sector.fixes_nm[route[0]] for route in (STRAIGHT, REVERSED)])
    distance_nm = np.linalg.norm(ends[1] - ends[0])
    np.testing.assert_allclose(observation[8:], [0.5, distance_nm / 150.0], atol=2e-4)
    # Cleared 90 degrees to the left, the first has the second to its right.
    turned = state.traffic._replace(cleared_heading_deg=jnp.array([45.19 - 90.0 + 360.0, 225.19]))
    np.testing.assert_allclose(task.observe(state._replace(traffic=turned))[8], 0.75, atol=2e-4)


def test_an_exited_aircraft_is_far_away_and_no_threat(traffic_on):
    task = avoidance(safety=2.0)
    both = traffic_on(STRAIGHT, REVERSED)
    state = task.begin(both._replace(active=jnp.array([True, False])))
    np.testing.assert_allclose(task.observe(state)[8:], [0.5, 1.0])
    assert float(task.advance(state)[1].reward[0]) == 0.0


@pytest.mark.slow
def test_safety_reward_is_that_of_the_worst_pair():
    settings = NavigationSettings(name="avoidance", aircraft=3, pair_features=("theta", "d"))
    weights = RewardSettings(centreline=0.0, damping=0.0, terminal=0.0, safety=2.0)
    task = build_task(NavigationSettings(**_fields(settings) | {"reward": weights}))
    # Head-on 80 NM apart, and a third one far to the side of both.
    state = task.begin(traffic([(0, 0), (0, 80), (60, 40)], [0, 180, 90]))
    _, outcome = jax.jit(task.advance)(state)
    assert float(outcome.reward[0]) == pytest.approx(2.0 * (80.0 - 1.6) / 150.0 - 2.0, abs=0.02)


def _fields(struct):
    return {name: getattr(struct, name) for name in struct.__struct_fields__}


@pytest.mark.parametrize("heading", [0.0, 45.0, 137.0, 225.0])
@pytest.mark.parametrize("rounding_kt", [-1e-4, 0.0, 1e-4])
def test_miss_without_relative_motion_has_one_sign(heading, rounding_kt):
    """Processors round the difference of equal velocities differently."""
    pairs = pairs_of(PLANE, traffic([(0, 0), (7, -3)], [heading, heading]))
    for east in (-1.0, 1.0):
        rounded = pairs._replace(
            velocity_kt=pairs.velocity_kt + jnp.asarray([[east * rounding_kt, rounding_kt]])
        )
        miss = float(PAIR_FEATURES["miss"].value(rounded)[0])
        assert miss == pytest.approx(np.hypot(7.0, 3.0), abs=1e-3)


@pytest.mark.parametrize(
    ("second", "headings", "sign"), [((4, 80), (0, 180), 1.0), ((-4, 80), (0, 180), -1.0)]
)
def test_sign_of_a_miss_is_its_side(second, headings, sign):
    """Not in the paper: positive if the second passes with the first on its right."""
    pairs = pairs_of(PLANE, traffic([(0, 0), second], headings))
    miss = float(PAIR_FEATURES["miss"].value(pairs)[0])
    assert miss == pytest.approx(sign * 4.0, abs=1e-3)
    mirrored = pairs_of(PLANE, traffic([(0, 0), (-second[0], second[1])], headings))
    assert miss == pytest.approx(-float(PAIR_FEATURES["miss"].value(mirrored)[0]), abs=1e-3)
    assert float(PAIR_FEATURES["time"].value(pairs)[0]) == pytest.approx(5.0, abs=1e-3)


def test_cost_of_a_conflict_is_proportional_to_its_depth(traffic_on):
    """Not in the paper: 1.5 NM inside 5.5 NM costs 1.5 times the weight per cycle."""
    task = avoidance(conflict=1.0)
    at = [np.array([0.0, 0.0]), np.array([4.0, 0.0])]
    state = task.begin(traffic_on(STRAIGHT, STRAIGHT, positions=at, headings=[0.0, 0.0]))
    assert float(task.advance(state)[1].reward[0]) == pytest.approx(-1.5, abs=1e-3)


@pytest.fixture(scope="module")
def three():
    """Three turning aircraft, which do not yet fly their cleared headings."""
    at, cleared, speeds = [(0, 0), (30, 25), (-20, 40)], [350.0, 200.0, 95.0], [480.0, 400.0, 300.0]
    flown = traffic(at, [10.0, 40.0, 30.0], speeds)
    flown = flown._replace(
        cleared_heading_deg=jnp.asarray(cleared),
        pending_turn=jnp.full(3, SHORTEST, dtype=jnp.int32),
    )
    return flown, np.asarray(flown.position_nm, dtype=np.float64), cleared, speeds


def wrap_180(angle_deg):
    return (angle_deg + 180.0) % 360.0 - 180.0


def bearing_deg(offset):
    return np.degrees(np.arctan2(*offset))


def expected_features(three, one, other):
    """The definitions in float64, with the closest approach at 100,001 times."""
    _, at, cleared, speeds = three
    offset = at[other] - at[one]
    angles = np.radians(cleared)
    velocity = np.array(speeds)[:, None] * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    relative = velocity[other] - velocity[one]
    hours = np.linspace(0.0, 150.0 / max(speeds[one], speeds[other]), 100_001)
    gaps = np.linalg.norm(offset + hours[:, None] * relative, axis=1)
    # Whether the first aircraft is right of the second's path relative to the first.
    right = np.dot(-offset, [relative[1], -relative[0]]) > 0.0
    with_turns, minutes = least_with_turns(three[0], one, other)
    return {
        "theta": wrap_180(bearing_deg(offset) - cleared[one]),
        "theta_back": wrap_180(bearing_deg(-offset) - cleared[other]),
        "track": wrap_180(cleared[other] - cleared[one]),
        "d": np.linalg.norm(offset),
        "miss": gaps.min() * (1.0 if right else -1.0),
        "time": 60.0 * hours[gaps.argmin()],
        "turn_miss": with_turns,
        "turn_time": minutes,
    }


STEP_S = 0.05


def flown_nm(traffic, aircraft, duration_s):
    """Displacements in float64, in steps of `STEP_S`: a cycle straight ahead, then the turn."""
    turn = wrap_180(
        float(traffic.cleared_heading_deg[aircraft]) - float(traffic.heading_deg[aircraft])
    )
    times_s = np.arange(0.0, duration_s, STEP_S) + STEP_S / 2.0
    turned = np.sign(turn) * np.minimum(1.5 * np.maximum(times_s - 6.0, 0.0), abs(turn))
    angles = np.radians(float(traffic.heading_deg[aircraft]) + turned)
    step_nm = float(traffic.ground_speed_kt[aircraft]) / 3600.0 * STEP_S
    steps = step_nm * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def least_with_turns(traffic, one, other):
    """The least distance [NM] and the minutes until then, within the horizon."""
    at = np.asarray(traffic.position_nm, dtype=np.float64)
    speeds = np.asarray(traffic.ground_speed_kt)
    duration_s = 3600.0 * RANGE_NM / max(speeds[one], speeds[other])
    offset = at[other] - at[one]
    offset = offset + flown_nm(traffic, other, duration_s) - flown_nm(traffic, one, duration_s)
    gaps = np.linalg.norm(offset, axis=1)
    return gaps.min(), gaps.argmin() * STEP_S / 60.0


SCALES = {
    "theta": (-180.0, 180.0, 0.5),
    "theta_back": (-180.0, 180.0, 0.5),
    "track": (-180.0, 180.0, 0.5),
    "d": (0.0, 150.0, 1.0),
    "miss": (-30.0, 30.0, 1.0),
    "time": (0.0, 20.0, 1.0),
    "turn_miss": (0.0, 30.0, 1.0),
    "turn_time": (0.0, 20.0, 1.0),
}
"""The values scaled to 0 and 1, and the observation of a pair of which one has exited."""


@pytest.mark.parametrize("active", [(True, True, True), (True, False, True)])
def test_observes_scaled_features_pair_by_pair(three, active):
    """In the order first and second, first and third, second and third."""
    flown = three[0]._replace(active=jnp.asarray(active))
    observed = np.asarray(observe_pairs(tuple(SCALES), PLANE, flown)).reshape(3, len(SCALES))
    for row, (one, other) in zip(observed, [(0, 1), (0, 2), (1, 2)], strict=True):
        values = expected_features(three, one, other)
        for found, (name, (low, high, exited)) in zip(row, SCALES.items(), strict=True):
            expected = np.clip((values[name] - low) / (high - low), 0.0, 1.0)
            expected = expected if active[one] and active[other] else exited
            # Turns are predicted in straight pieces of 20 s.
            allowed = 5e-3 if name.startswith("turn_") else 2e-4
            assert found == pytest.approx(expected, abs=allowed), (name, one, other)
    assert set(SCALES) == set(PAIR_FEATURES)


turn = st.integers(-16, 16).map(lambda tens: 10.0 * tens)


@pytest.mark.slow
@given(position, position, heading, heading, turn, turn, st.floats(300, 500), st.floats(300, 500))
def test_closest_approach_with_turns_is_that_of_the_flown_paths(
    first, second, first_deg, second_deg, first_turn, second_turn, first_kt, second_kt
):
    both = traffic([first, second], [first_deg, second_deg], [first_kt, second_kt])
    cleared = (both.heading_deg + jnp.array([first_turn, second_turn])) % 360.0
    both = both._replace(
        cleared_heading_deg=cleared, pending_turn=jnp.full(2, SHORTEST, dtype=jnp.int32)
    )
    found = float(PAIR_FEATURES["turn_miss"].value(pairs_of(PLANE, both))[0])
    assert found == pytest.approx(least_with_turns(both, 0, 1)[0], abs=0.35)


def test_turns_that_have_begun_are_predicted_to_their_end():
    """The first moves east only until its turn ends; then it flies parallel to the second."""
    both = traffic([(0, 0), (10, 0)], [45.0, 0.0])
    turning = both._replace(
        heading_deg=jnp.array([45.0, 0.0]),
        turn_deg=jnp.array([-45.0, 0.0]),
        cleared_heading_deg=jnp.array([0.0, 0.0]),
    )
    radius_nm = SPEED_KT / 3600.0 / np.radians(1.5)
    east_nm = radius_nm * (1.0 - np.cos(np.radians(45.0)))
    behind_nm = SPEED_KT * 30.0 / 3600.0 - radius_nm * np.sin(np.radians(45.0))
    found = float(PAIR_FEATURES["turn_miss"].value(pairs_of(PLANE, turning))[0])
    assert found == pytest.approx(np.hypot(10.0 - east_nm, behind_nm), abs=1e-3)


def test_names_features_pair_by_pair():
    assert pair_names(("theta", "d"), 3) == (
        *("theta_12", "d_12"),
        *("theta_13", "d_13"),
        *("theta_23", "d_23"),
    )


@pytest.mark.parametrize(
    ("positions", "headings", "minutes"),
    [
        ([(0, 0), (0, 12)], [180, 0], 0.0),  # diverging: closest now
        ([(0, 0), (0, 12)], [0, 0], 0.0),  # constant distance
        ([(0, 0), (0, 400)], [0, 180], 150.0 / 8.0),  # converging beyond the horizon
    ],
)
def test_time_of_closest_approach_is_within_the_horizon(positions, headings, minutes):
    pairs = pairs_of(PLANE, traffic(positions, headings))
    assert float(PAIR_FEATURES["time"].value(pairs)[0]) == pytest.approx(minutes, abs=1e-3)


def test_distances_are_true_lengths_far_from_the_origin():
    """Three degrees north of an origin at 60 N, the plane is stretched by a tenth."""
    north = MercatorPlane(60.0, 0.0)
    at = north.to_plane([63.1, 62.9], [0.2, -0.1])
    flown = traffic([(0, 0), (0, 0)], [0.0, 0.0])._replace(
        position_nm=jnp.asarray(at, dtype=jnp.float32)
    )
    metres = WGS84.inv(0.2, 63.1, -0.1, 62.9)[2]
    assert float(pairs_of(north, flown).distance_nm[0]) == pytest.approx(
        metres / METRES_PER_NM, abs=0.005
    )
