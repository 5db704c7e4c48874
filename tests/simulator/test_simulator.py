"""`instruct` and `advance` as a whole: who hears, who moves, and the symmetries of the world."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skystack.simulator.simulator import adopt, instruct
from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, SHORTEST, Traffic

from .flights import MODELS, Told, angle_between_deg, clearance, flights

CLEARED = {"cleared_heading_deg", "cleared_level_ticks", "pending_turn"}
"""The only fields that `instruct` may change."""
CYCLES = 40


def same(a, b, fields=Traffic._fields):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in fields)


def crowd(model, n, own_navigation=False, seed=0):
    """Traffic of `n` with random places, headings and levels."""
    rng = np.random.default_rng(seed)
    return flights(model, own_navigation).start(
        rng.uniform(-40.0, 40.0, (n, 2)),
        rng.integers(0, 360, n).astype(float),
        rng.integers(20, 40, n) * 10.0,
        rng.integers(0, 10, n),
        own_navigation,
    )


def orders(n, seed=0, count=60):
    """Random clearances over the first cycles, headings by all three ways of turning."""
    rng = np.random.default_rng(seed)
    turns = (SHORTEST, LEFT, RIGHT)
    return [
        Told(
            int(rng.integers(0, CYCLES - 5)),
            int(rng.integers(0, n)),
            heading_deg=float(rng.integers(0, 360)) if rng.random() < 0.7 else None,
            fl=float(rng.integers(20, 40) * 10) if rng.random() < 0.5 else None,
            turn=turns[int(rng.integers(0, 3))],
        )
        for _ in range(count)
    ]


def headed(told, change_deg, flip=False):
    """The same clearances in a world turned clockwise, or mirrored east to west."""
    other = {LEFT: RIGHT, RIGHT: LEFT, SHORTEST: SHORTEST}
    return [
        entry
        if entry.heading_deg is None
        else entry._replace(
            heading_deg=((-1.0 if flip else 1.0) * entry.heading_deg + change_deg) % 360.0,
            turn=other[entry.turn] if flip else entry.turn,
        )
        for entry in told
    ]


TOLD = st.lists(
    st.builds(
        Told,
        cycle=st.just(0),
        aircraft=st.integers(0, 5),
        heading_deg=st.none() | st.integers(0, 359).map(float),
        fl=st.none() | st.integers(20, 40).map(lambda n: n * 10.0),
        turn=st.sampled_from([SHORTEST, LEFT, RIGHT]),
    ),
    max_size=6,
)


@settings(max_examples=50)
@given(TOLD, st.lists(st.booleans(), min_size=6, max_size=6))
def test_instruct_changes_only_what_it_clears(told, active):
    before = crowd("table", 6)._replace(active=jnp.asarray(active))
    after = instruct(before, clearance(6, told))
    assert same(before, after, set(Traffic._fields) - CLEARED)
    for aircraft in range(6):
        heard = [t for t in told if t.aircraft == aircraft and active[aircraft]]
        headings = [t for t in heard if t.heading_deg is not None]
        levels = [t.fl for t in heard if t.fl is not None]
        if headings:
            assert float(after.cleared_heading_deg[aircraft]) == headings[-1].heading_deg
            assert int(after.pending_turn[aircraft]) == headings[-1].turn
        else:
            assert after.cleared_heading_deg[aircraft] == before.cleared_heading_deg[aircraft]
            assert int(after.pending_turn[aircraft]) == NO_TURN
        expected = levels[-1] * 6000.0 if levels else float(before.cleared_level_ticks[aircraft])
        assert float(after.cleared_level_ticks[aircraft]) == expected


def test_silence_changes_nothing():
    before = crowd("table", 6)
    assert same(before, instruct(before, clearance(6, ())))


def test_the_last_word_of_a_cycle_counts():
    traffic = crowd("table", 2)
    many = instruct(traffic, clearance(2, [Told(0, 0, heading_deg=10, fl=300, turn=LEFT)]))
    many = instruct(many, clearance(2, [Told(0, 0, heading_deg=20), Told(0, 1, heading_deg=5)]))
    few = [Told(0, 0, heading_deg=20, fl=300), Told(0, 1, heading_deg=5)]
    assert same(many, instruct(traffic, clearance(2, few)))


@pytest.mark.parametrize("own_navigation", [False, True])
def test_inactive_aircraft_neither_move_nor_hear(own_navigation):
    n = 6
    active = np.array([True, False, True, False, False, True])
    traffic = crowd("table", n, own_navigation)._replace(active=jnp.asarray(active))
    # One of them was told something before it left.
    traffic = instruct(
        traffic._replace(active=jnp.ones(n, dtype=bool)),
        clearance(n, [Told(0, 3, heading_deg=77, fl=250)]),
    )
    traffic = traffic._replace(active=jnp.asarray(active))
    rows = flights("table", own_navigation).fly(traffic, CYCLES, orders(n))
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
    ours = flights(model, own_navigation)
    traffic = crowd(model, 6, own_navigation)
    told = orders(6)
    alone = ours.fly(traffic, CYCLES, [t for t in told if t.aircraft == 2])
    everybody = ours.fly(traffic, CYCLES, told)
    silence = ours.fly(traffic, CYCLES)
    for name in Traffic._fields:
        got = getattr(alone, name)
        assert np.array_equal(got[:, 2], getattr(everybody, name)[:, 2])
        others = [0, 1, 3, 4, 5]
        assert np.array_equal(got[:, others], getattr(silence, name)[:, others])
    assert not np.array_equal(alone.position_nm[-1, 2], silence.position_nm[-1, 2])


@pytest.mark.parametrize("own_navigation", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_two_aircraft_fly_the_same_among_two_hundred(model, own_navigation):
    ours = flights(model, own_navigation)
    many = crowd(model, 200, own_navigation)
    told = [*orders(2), *(t._replace(aircraft=t.aircraft + 2) for t in orders(198, seed=1))]
    few = jax.tree.map(lambda leaf: leaf[:2], many)
    crowded = ours.fly(many, CYCLES, told)
    alone = ours.fly(few, CYCLES, [t for t in told if t.aircraft < 2])
    for name in Traffic._fields:
        assert getattr(crowded, name)[:, :2] == pytest.approx(getattr(alone, name), abs=1e-3)
    assert np.array_equal(crowded.level_ticks[:, :2], alone.level_ticks)


@pytest.mark.parametrize("model", MODELS)
def test_the_order_of_the_aircraft_does_not_matter(model):
    ours, n = flights(model), 6
    traffic, told = crowd(model, n), orders(n)
    backwards = jax.tree.map(lambda leaf: leaf[::-1], traffic)
    rows = ours.fly(traffic, CYCLES, told)
    swapped = ours.fly(backwards, CYCLES, [t._replace(aircraft=5 - t.aircraft) for t in told])
    for name in Traffic._fields:
        assert getattr(swapped, name)[:, ::-1] == pytest.approx(getattr(rows, name), abs=1e-4)


def transformed_flights(model, move, change_deg, flip=False):
    """Paths and headings of the same flights here, and in a world moved by `move`."""
    ours, traffic, told = flights(model), crowd(model, 6), orders(6)
    sign = -1.0 if flip else 1.0
    heading = np.mod(sign * np.asarray(traffic.heading_deg) + change_deg, 360.0)
    there = ours.start(
        move(np.asarray(traffic.position_nm, dtype=float)), heading, traffic.level_ticks / 6000.0
    )
    here = ours.fly(traffic, CYCLES, told)
    return here, ours.fly(there, CYCLES, headed(told, change_deg, flip))


def assert_moved(here, there, move, change_deg, flip=False):
    expected = (-1.0 if flip else 1.0) * here.heading_deg + change_deg
    assert np.max(angle_between_deg(there.heading_deg, expected)) < 1e-3
    assert there.position_nm == pytest.approx(move(here.position_nm.astype(float)), abs=1e-3)
    assert np.array_equal(there.level_ticks, here.level_ticks)
    assert np.array_equal(there.ground_speed_kt, here.ground_speed_kt)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("shift_nm", [100.0, -45.5])
def test_a_world_moved_east_or_west_flies_the_same(model, shift_nm):
    def move(points):
        return points + np.array([shift_nm, 0.0])

    here, there = transformed_flights(model, move, 0.0)
    assert_moved(here, there, move, 0.0)


@pytest.mark.parametrize("model", MODELS)
def test_a_world_turned_half_round_flies_turned(model):
    def move(points):
        return -points

    here, there = transformed_flights(model, move, 180.0)
    assert_moved(here, there, move, 180.0)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("axes", "change_deg"), [((-1.0, 1.0), 0.0), ((1.0, -1.0), 180.0)])
def test_a_world_mirrored_at_the_equator_or_a_meridian_flies_mirrored(model, axes, change_deg):
    def move(points):
        return points * np.array(axes)

    here, there = transformed_flights(model, move, change_deg, flip=True)
    assert_moved(here, there, move, change_deg, flip=True)


def test_adopting_is_idempotent():
    once = adopt(instruct(crowd("table", 6), clearance(6, orders(6))))
    assert same(once, adopt(once))


def test_traffic_starts_cleared_to_what_it_flies():
    traffic = crowd("table", 6)
    assert np.array_equal(traffic.cleared_heading_deg, traffic.heading_deg)
    assert np.array_equal(traffic.flown_heading_deg, traffic.heading_deg)
    assert np.array_equal(traffic.cleared_level_ticks, traffic.level_ticks)
    assert np.array_equal(traffic.flown_level_ticks, traffic.level_ticks)
    assert traffic.active.all()
    flown = flights("table").fly(traffic, 3)
    for name in ("heading_deg", "level_ticks", "cleared_heading_deg", "cleared_level_ticks"):
        assert np.array_equal(getattr(flown, name)[-1], getattr(traffic, name))


def test_vmapped_worlds_fly_like_single_ones():
    worlds = [crowd("table", 2, seed=seed) for seed in range(5)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *worlds)
    simulator = flights("table").simulator
    together = jax.jit(jax.vmap(simulator.advance))(stacked)
    for index, world in enumerate(worlds):
        alone = flights("table").fly(world, 1)
        for name in Traffic._fields:
            one, got = getattr(alone, name)[-1], getattr(together, name)[index]
            assert np.asarray(got) == pytest.approx(one, abs=1e-4)
