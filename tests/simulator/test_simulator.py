"""`instruct` and `advance`: which aircraft are cleared, which move, and symmetries of flight."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skystack.simulator.simulator import adopt, instruct
from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, SHORTEST, Traffic

from .flights import MODELS, TimedClearance, angle_between_deg, clearance, flights

CLEARED = {"cleared_heading_deg", "cleared_level_ticks", "pending_turn"}
"""The only fields that `instruct` may change."""
CYCLES = 40


FIELDS = tuple(name for name in Traffic._fields if name not in Traffic._field_defaults)
"""The fields that are never None."""


def same(a, b, fields=FIELDS):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in fields)


def crowd(model, n, own_navigation=False, seed=0):
    """`n` aircraft with random positions, headings and levels."""
    rng = np.random.default_rng(seed)
    return flights(model, own_navigation).start(
        rng.uniform(-40.0, 40.0, (n, 2)),
        rng.integers(0, 360, n).astype(float),
        rng.integers(20, 40, n) * 10.0,
        rng.integers(0, 10, n),
        own_navigation,
    )


def random_clearances(n, seed=0, count=60):
    """Random clearances in most of the cycles, with turns in all three directions."""
    rng = np.random.default_rng(seed)
    turns = (SHORTEST, LEFT, RIGHT)
    return [
        TimedClearance(
            int(rng.integers(0, CYCLES - 5)),
            int(rng.integers(0, n)),
            heading_deg=float(rng.integers(0, 360)) if rng.random() < 0.7 else None,
            fl=float(rng.integers(20, 40) * 10) if rng.random() < 0.5 else None,
            turn=turns[int(rng.integers(0, 3))],
        )
        for _ in range(count)
    ]


def transformed(clearances, change_deg, flip=False):
    """The same clearances, rotated clockwise or mirrored east to west."""
    other = {LEFT: RIGHT, RIGHT: LEFT, SHORTEST: SHORTEST}
    return [
        entry
        if entry.heading_deg is None
        else entry._replace(
            heading_deg=((-1.0 if flip else 1.0) * entry.heading_deg + change_deg) % 360.0,
            turn=other[entry.turn] if flip else entry.turn,
        )
        for entry in clearances
    ]


CLEARANCES = st.lists(
    st.builds(
        TimedClearance,
        cycle=st.just(0),
        aircraft=st.integers(0, 5),
        heading_deg=st.none() | st.integers(0, 359).map(float),
        fl=st.none() | st.integers(20, 40).map(lambda n: n * 10.0),
        turn=st.sampled_from([SHORTEST, LEFT, RIGHT]),
    ),
    max_size=6,
)


@settings(max_examples=50)
@given(CLEARANCES, st.lists(st.booleans(), min_size=6, max_size=6))
def test_instruct_changes_only_the_cleared_values(clearances, active):
    before = crowd("table", 6)._replace(active=jnp.asarray(active))
    after = instruct(before, clearance(6, clearances))
    assert same(before, after, set(FIELDS) - CLEARED)
    for aircraft in range(6):
        own = [each for each in clearances if each.aircraft == aircraft and active[aircraft]]
        headings = [each for each in own if each.heading_deg is not None]
        levels = [each.fl for each in own if each.fl is not None]
        if headings:
            assert float(after.cleared_heading_deg[aircraft]) == headings[-1].heading_deg
            assert int(after.pending_turn[aircraft]) == headings[-1].turn
        else:
            assert after.cleared_heading_deg[aircraft] == before.cleared_heading_deg[aircraft]
            assert int(after.pending_turn[aircraft]) == NO_TURN
        expected = levels[-1] * 6000.0 if levels else float(before.cleared_level_ticks[aircraft])
        assert float(after.cleared_level_ticks[aircraft]) == expected


def test_no_clearance_changes_nothing():
    before = crowd("table", 6)
    assert same(before, instruct(before, clearance(6, ())))


def test_the_last_clearance_of_a_cycle_counts():
    traffic = crowd("table", 2)
    repeated = instruct(
        traffic, clearance(2, [TimedClearance(0, 0, heading_deg=10, fl=300, turn=LEFT)])
    )
    repeated = instruct(
        repeated,
        clearance(2, [TimedClearance(0, 0, heading_deg=20), TimedClearance(0, 1, heading_deg=5)]),
    )
    last = [TimedClearance(0, 0, heading_deg=20, fl=300), TimedClearance(0, 1, heading_deg=5)]
    assert same(repeated, instruct(traffic, clearance(2, last)))


@pytest.mark.parametrize("own_navigation", [False, True])
def test_inactive_aircraft_neither_move_nor_follow_clearances(own_navigation):
    n = 6
    active = np.array([True, False, True, False, False, True])
    traffic = crowd("table", n, own_navigation)._replace(active=jnp.asarray(active))
    # One of them was cleared before it became inactive.
    traffic = instruct(
        traffic._replace(active=jnp.ones(n, dtype=bool)),
        clearance(n, [TimedClearance(0, 3, heading_deg=77, fl=250)]),
    )
    traffic = traffic._replace(active=jnp.asarray(active))
    rows = flights("table", own_navigation).fly(traffic, CYCLES, random_clearances(n))
    for name in (
        "position_nm",
        "heading_deg",
        "level_ticks",
        "ground_speed_kt",
        "cleared_level_ticks",
    ):
        values = getattr(rows, name)
        assert np.array_equal(values[:, ~active], np.repeat(values[:1, ~active], CYCLES + 1, 0))
    assert (np.abs(np.diff(rows.position_nm[:, active], axis=0)).max(axis=-1) > 0.1).all()


@pytest.mark.parametrize("own_navigation", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_instructing_one_aircraft_never_changes_another(model, own_navigation):
    simulation = flights(model, own_navigation)
    traffic = crowd(model, 6, own_navigation)
    clearances = random_clearances(6)
    alone = simulation.fly(traffic, CYCLES, [each for each in clearances if each.aircraft == 2])
    together = simulation.fly(traffic, CYCLES, clearances)
    uncleared = simulation.fly(traffic, CYCLES)
    for name in FIELDS:
        got = getattr(alone, name)
        assert np.array_equal(got[:, 2], getattr(together, name)[:, 2])
        others = [0, 1, 3, 4, 5]
        assert np.array_equal(got[:, others], getattr(uncleared, name)[:, others])
    assert not np.array_equal(alone.position_nm[-1, 2], uncleared.position_nm[-1, 2])


@pytest.mark.slow
@pytest.mark.parametrize("own_navigation", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_two_aircraft_fly_the_same_among_two_hundred(model, own_navigation):
    simulation = flights(model, own_navigation)
    many = crowd(model, 200, own_navigation)
    clearances = [
        *random_clearances(2),
        *(each._replace(aircraft=each.aircraft + 2) for each in random_clearances(198, seed=1)),
    ]
    few = jax.tree.map(lambda leaf: leaf[:2], many)
    crowded = simulation.fly(many, CYCLES, clearances)
    alone = simulation.fly(few, CYCLES, [each for each in clearances if each.aircraft < 2])
    for name in FIELDS:
        assert getattr(crowded, name)[:, :2] == pytest.approx(getattr(alone, name), abs=1e-3)
    assert np.array_equal(crowded.level_ticks[:, :2], alone.level_ticks)


@pytest.mark.parametrize("model", MODELS)
def test_the_order_of_the_aircraft_does_not_matter(model):
    simulation, n = flights(model), 6
    traffic, clearances = crowd(model, n), random_clearances(n)
    backwards = jax.tree.map(lambda leaf: leaf[::-1], traffic)
    rows = simulation.fly(traffic, CYCLES, clearances)
    reversed_clearances = [each._replace(aircraft=5 - each.aircraft) for each in clearances]
    reversed_rows = simulation.fly(backwards, CYCLES, reversed_clearances)
    for name in FIELDS:
        assert getattr(reversed_rows, name)[:, ::-1] == pytest.approx(getattr(rows, name), abs=1e-4)


def transformed_flights(model, move, change_deg, flip=False):
    """The same flights in their original positions and in those given by `move`."""
    simulation, traffic, clearances = flights(model), crowd(model, 6), random_clearances(6)
    sign = -1.0 if flip else 1.0
    heading = np.mod(sign * np.asarray(traffic.heading_deg) + change_deg, 360.0)
    moved_traffic = simulation.start(
        move(np.asarray(traffic.position_nm, dtype=float)), heading, traffic.level_ticks / 6000.0
    )
    original = simulation.fly(traffic, CYCLES, clearances)
    return original, simulation.fly(
        moved_traffic, CYCLES, transformed(clearances, change_deg, flip)
    )


def assert_moved(original, moved, move, change_deg, flip=False):
    expected = (-1.0 if flip else 1.0) * original.heading_deg + change_deg
    assert np.max(angle_between_deg(moved.heading_deg, expected)) < 1e-3
    assert moved.position_nm == pytest.approx(move(original.position_nm.astype(float)), abs=1e-3)
    assert np.array_equal(moved.level_ticks, original.level_ticks)
    assert np.array_equal(moved.ground_speed_kt, original.ground_speed_kt)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("shift_nm", [100.0, -45.5])
def test_flights_do_not_depend_on_longitude(model, shift_nm):
    def move(points):
        return points + np.array([shift_nm, 0.0])

    original, moved = transformed_flights(model, move, 0.0)
    assert_moved(original, moved, move, 0.0)


@pytest.mark.parametrize("model", MODELS)
def test_flights_are_symmetric_under_half_a_turn(model):
    def move(points):
        return -points

    original, moved = transformed_flights(model, move, 180.0)
    assert_moved(original, moved, move, 180.0)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("axes", "change_deg"), [((-1.0, 1.0), 0.0), ((1.0, -1.0), 180.0)])
def test_flights_are_symmetric_under_reflection(model, axes, change_deg):
    def move(points):
        return points * np.array(axes)

    original, moved = transformed_flights(model, move, change_deg, flip=True)
    assert_moved(original, moved, move, change_deg, flip=True)


def test_adopting_is_idempotent():
    once = adopt(instruct(crowd("table", 6), clearance(6, random_clearances(6))))
    assert same(once, adopt(once))


def test_traffic_starts_cleared_to_its_heading_and_level():
    traffic = crowd("table", 6)
    assert np.array_equal(traffic.cleared_heading_deg, traffic.heading_deg)
    assert np.array_equal(traffic.flown_heading_deg, traffic.heading_deg)
    assert np.array_equal(traffic.cleared_level_ticks, traffic.level_ticks)
    assert np.array_equal(traffic.flown_level_ticks, traffic.level_ticks)
    assert traffic.active.all()
    flown = flights("table").fly(traffic, 3)
    for name in ("heading_deg", "level_ticks", "cleared_heading_deg", "cleared_level_ticks"):
        assert np.array_equal(getattr(flown, name)[-1], getattr(traffic, name))


def test_vmapped_scenarios_fly_like_single_ones():
    scenarios = [crowd("table", 2, seed=seed) for seed in range(5)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenarios)
    simulator = flights("table").simulator
    together = jax.jit(jax.vmap(simulator.advance))(stacked)
    for index, scenario in enumerate(scenarios):
        alone = flights("table").fly(scenario, 1)
        for name in FIELDS:
            one, got = getattr(alone, name)[-1], getattr(together, name)[index]
            assert np.asarray(got) == pytest.approx(one, abs=1e-4)
