"""Climbs and descents: rates, ground speeds, exact level captures and no drift."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import instruct

from .flights import MODELS, TimedClearance, clearance, flights

ORIGIN = np.zeros((1, 2))
FL_PER_CYCLE = {"constant": 2.0, "table": 2.5}
RATE_FT_MIN = {"constant": 2000.0, "table": 2500.0}
FT_MIN_PER_KT = 1852.0 / 0.3048 / 60.0


def climb(model, start_fl, clearances, cycles, heading_deg=0.0):
    simulation = flights(model)
    return simulation.fly(simulation.start(ORIGIN, heading_deg, start_fl), cycles, clearances)


def levels_fl(rows):
    return rows.level_ticks[:, 0].astype(float) / TICKS_PER_FL


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("start_fl", "target_fl"), [(100.0, 300.0), (300.0, 100.0), (200.0, 210.0)]
)
def test_every_row_of_a_climb(model, start_fl, target_fl):
    rows = climb(model, start_fl, [TimedClearance(0, 0, fl=target_fl)], 110)
    change = target_fl - start_fl
    moved = np.minimum(FL_PER_CYCLE[model] * np.arange(-1, 110).clip(0), abs(change))
    assert levels_fl(rows).tolist() == (start_fl + np.sign(change) * moved).tolist()


@pytest.mark.parametrize(
    ("model", "start_fl", "target_fl", "cycles", "distance_nm"),
    [
        ("constant", 100.0, 300.0, 100, 66.585),
        ("constant", 300.0, 100.0, 100, 66.585),
        # One cycle more than 200 / 2.5: the last second falls into the next cycle.
        ("table", 100.0, 300.0, 81, 51.766),
        ("table", 300.0, 100.0, 81, 50.001),
    ],
)
def test_distance_covered_in_200_levels(model, start_fl, target_fl, cycles, distance_nm):
    rows = climb(
        model, start_fl, [TimedClearance(0, 0, fl=target_fl)], cycles + 1, heading_deg=90.0
    )
    assert levels_fl(rows)[-1] == target_fl
    covered = rows.position_nm[-1, 0] - rows.position_nm[1, 0]
    assert covered == pytest.approx((distance_nm, 0.0), abs=5e-3)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("fl", [100.0, 200.0, 305.0, 350.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_ground_speed_excludes_the_vertical_speed(model, fl, sign):
    """Ground speed^2 = airspeed^2 - vertical speed^2, at the level where the second begins."""
    rows = climb(model, fl, [TimedClearance(0, 0, fl=fl + sign * 50.0)], 5)
    assert rows.vertical_speed_ft_min[1:, 0].tolist() == [0.0, *[sign * RATE_FT_MIN[model]] * 4]
    before = np.float32(rows.level_ticks[4, 0] + 5 * sign * RATE_FT_MIN[model])
    (airspeed,) = (
        flights(model)
        .simulator.performance.true_airspeed_kt(
            jnp.asarray([before]), jnp.asarray([sign], dtype=jnp.float32)
        )
        .tolist()
    )
    vertical_kt = RATE_FT_MIN[model] / FT_MIN_PER_KT
    assert np.hypot(rows.ground_speed_kt[5, 0], vertical_kt) == pytest.approx(airspeed, abs=1e-3)


def test_ground_speed_of_a_constant_climb():
    rows = climb("constant", 100.0, [TimedClearance(0, 0, fl=300)], 3)
    assert rows.ground_speed_kt[:, 0] == pytest.approx(
        [400.0, 400.0, 399.512151, 399.512151], abs=1e-4
    )


def test_speed_changes_at_once_with_the_phase():
    """290 kt calibrated in the climb, 300 in level flight: 451.41 and 465.94 kt true at FL300."""
    rows = climb("table", 290.0, [TimedClearance(0, 0, fl=300)], 8)
    speed = rows.ground_speed_kt[:, 0]
    assert speed[1] == pytest.approx(458.8, abs=0.5)
    assert speed[5] == pytest.approx(np.sqrt(451.416**2 - 24.685**2), abs=0.01)
    assert speed[6] == pytest.approx(465.9408, abs=1e-3)
    assert rows.vertical_speed_ft_min[6, 0] == 0.0


def test_a_lower_level_reverses_a_climb():
    clearances = [
        TimedClearance(0, 0, fl=340),
        TimedClearance(5, 0, fl=300),
        TimedClearance(7, 0, fl=350),
    ]
    rows = climb("constant", 300.0, clearances, 12)
    expected = [300, 300, 302, 304, 306, 308, 310, 308, 306, 308, 310, 312, 314]
    assert levels_fl(rows).tolist() == expected


def test_a_level_between_two_seconds_is_captured_exactly():
    """From FL305 up 10 levels at 2,500 ft/min: 24 s; from FL300.25 up to 310: 23.4 s."""
    simulation = flights("table")
    traffic = simulation.start(np.zeros((2, 2)), 0.0, [305.0, 300.25])
    rows = simulation.fly(traffic, 6, [TimedClearance(0, 0, fl=315), TimedClearance(0, 1, fl=310)])
    assert (rows.level_ticks / TICKS_PER_FL)[:, 0].tolist() == [
        305,
        305,
        307.5,
        310,
        312.5,
        315,
        315,
    ]
    assert (rows.level_ticks / TICKS_PER_FL)[4:, 1].tolist() == [307.75, 310.0, 310.0]


def test_aircraft_do_not_climb_through_the_ceiling():
    rows = climb("table", 395.0, [TimedClearance(0, 0, fl=420), TimedClearance(8, 0, fl=380)], 14)
    expected = [395, 395, 397.5, 400, 400, 400, 400, 400, 400, 400, 397.5, 395, 392.5, 390, 387.5]
    assert levels_fl(rows).tolist() == expected
    # At the ceiling it flies level, still at the speed of a climb.
    assert rows.ground_speed_kt[6, 0] == pytest.approx(453.119676, abs=1e-3)
    assert rows.vertical_speed_ft_min[6, 0] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_a_thousand_climbs_and_descents_return_exactly(model):
    """Levels are whole ticks in every row, and the last cleared level is reached exactly."""
    simulator = flights(model).simulator
    rng = np.random.default_rng(1)
    targets = rng.integers(11, 40, (1000, 8)) * 10
    targets[-1] = 300

    def change(traffic, target_fl):
        clearances = clearance(8, ())._replace(
            changes_level=jnp.ones(8, dtype=bool), level_ticks=target_fl * TICKS_PER_FL
        )
        traffic = instruct(traffic, clearances)
        traffic = jax.lax.fori_loop(0, 20, lambda _, state: simulator.advance(state), traffic)
        return traffic, traffic.level_ticks

    start = flights(model).start(np.zeros((8, 2)), 0.0, 300.0)
    end, levels = jax.jit(lambda t, goals: jax.lax.scan(change, t, goals))(
        start, jnp.asarray(targets, dtype=jnp.float32)
    )
    assert np.array_equal(levels, np.round(levels))
    # Complete the last climb or descent.
    end = jax.jit(lambda t: jax.lax.fori_loop(0, 150, lambda _, s: simulator.advance(s), t))(end)
    assert end.level_ticks.tolist() == [300.0 * TICKS_PER_FL] * 8
    assert end.vertical_speed_ft_min.tolist() == [0.0] * 8


@pytest.mark.slow
@settings(max_examples=30)
@given(
    st.sampled_from(MODELS),
    st.lists(st.integers(10, 40).map(lambda n: 10 * n), min_size=4, max_size=4),
    st.lists(st.integers(10, 40).map(lambda n: 10 * n), min_size=4, max_size=4),
)
def test_cleared_levels_are_reached_and_never_overshot(model, start_fl, target_fl):
    simulation = flights(model)
    traffic = simulation.start(np.zeros((4, 2)), 0.0, np.array(start_fl, dtype=float))
    clearances = [TimedClearance(0, a, fl=fl) for a, fl in enumerate(target_fl)]
    rows = simulation.fly(traffic, 155, clearances).level_ticks / TICKS_PER_FL
    low, high = np.minimum(start_fl, target_fl), np.maximum(start_fl, target_fl)
    assert ((rows >= low) & (rows <= high)).all()
    assert (np.abs(np.diff(rows, axis=0)) <= FL_PER_CYCLE[model]).all()
    assert rows[-1].tolist() == target_fl
