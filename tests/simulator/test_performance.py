"""Performance models against BluebirdDT's table of airspeeds and the standard atmosphere."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.simulator.performance import (
    TICKS_PER_FL,
    ConstantPerformance,
    TablePerformance,
    performance,
    tas_from_cas,
    tas_from_mach,
)
from skystack.simulator.traffic import ticks

LEVELS_FL = (100, 150, 200, 250, 300, 310, 350, 400)
CLIMB, CRUISE, DESCENT = 1.0, 0.0, -1.0
AIRSPEEDS_KT = {
    CRUISE: (
        *(288.702313, 371.454771, 400.097458, 431.522383),
        *(465.940793, 469.411414, 461.134981, 458.855368),
    ),
    CLIMB: (
        *(288.702313, 359.459285, 387.372449, 418.047908),
        *(451.709540, 458.818573, 455.370794, 453.119676),
    ),
    DESCENT: (
        *(288.702313, 347.429234, 374.594167, 404.496728),
        *(437.372866, 444.324653, 449.606606, 447.383984),
    ),
}
"""True airspeeds of the MEDIUM class at the levels above."""
MEDIUM = TablePerformance()


def array(*values):
    return jnp.asarray(values, dtype=jnp.float32)


def airspeed_kt(model, fl, phase):
    return float(model.true_airspeed_kt(array(fl * TICKS_PER_FL), array(phase))[0])


def rate_ft_min(model, fl, phase):
    return float(model.vertical_speed_ft_min(array(fl * TICKS_PER_FL), array(phase))[0])


@pytest.mark.parametrize("phase", AIRSPEEDS_KT)
@pytest.mark.parametrize("column", range(len(LEVELS_FL)))
def test_airspeeds_of_the_table(phase, column):
    expected = AIRSPEEDS_KT[phase][column]
    assert airspeed_kt(MEDIUM, LEVELS_FL[column], phase) == pytest.approx(expected, abs=1e-3)
    row = [CLIMB, CRUISE, DESCENT].index(phase)
    assert MEDIUM.airspeeds_kt[row, LEVELS_FL[column]] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("row", "cas_kt", "mach", "transition_fl"),
    [
        (CRUISE, 300.0, 0.80, 305.946),
        (CLIMB, 290.0, 0.79, 315.117),
        (DESCENT, 280.0, 0.78, 324.644),
    ],
)
def test_mach_takes_over_at_the_transition_level(row, cas_kt, mach, transition_fl):
    levels = transition_fl + np.array([-0.01, 0.0, 0.01])
    by_cas = tas_from_cas(levels, np.full(3, cas_kt))
    by_mach = tas_from_mach(levels, mach)
    assert by_cas[1] == pytest.approx(by_mach[1], abs=1e-3)
    assert by_cas[0] < by_mach[0]
    assert by_cas[2] > by_mach[2]


@given(st.floats(0.0, 450.0), st.sampled_from([CLIMB, CRUISE, DESCENT]))
def test_airspeeds_between_whole_levels_follow_the_formulas(fl, phase):
    """Not only at whole flight levels, where the table has their values."""
    cas = {CLIMB: (250.0, 290.0), CRUISE: (250.0, 300.0), DESCENT: (250.0, 280.0)}[phase]
    mach = {CLIMB: 0.79, CRUISE: 0.80, DESCENT: 0.78}[phase]
    levels = np.array([round(fl * TICKS_PER_FL) / TICKS_PER_FL])
    by_cas = tas_from_cas(levels, np.interp(levels, [100.0, 150.0], cas))
    expected = min(by_cas[0], tas_from_mach(levels, mach)[0])
    # Where two pieces meet, a straight line over one flight level cuts the corner.
    at_corner = int(levels[0]) in (305, 315, 324, 360)
    assert airspeed_kt(MEDIUM, float(levels[0]), phase) == pytest.approx(
        expected, abs=0.3 if at_corner else 2e-3
    )


@pytest.mark.parametrize(("fl", "expected"), [(100.0, 457.17), (200.0, 491.45), (300.0, 471.458)])
def test_airspeeds_for_another_calibrated_airspeed(fl, expected):
    """A selected 400 kt under BluebirdDT's LinearPredictor; at FL300 the Mach number limits it."""
    fast = TablePerformance(low_cas_kt=(400.0,) * 3, high_cas_kt=(400.0,) * 3)
    assert airspeed_kt(fast, fl, CRUISE) == pytest.approx(expected, abs=6e-3)


def test_calibrated_is_true_airspeed_at_sea_level():
    cas = np.array([100.0, 250.0, 400.0])
    assert tas_from_cas(np.zeros(3), cas) == pytest.approx(cas, rel=1e-6)


@pytest.mark.parametrize(
    ("fl", "speed_of_sound_m_s"), [(0.0, 340.294), (360.892, 295.069), (500.0, 295.069)]
)
def test_speed_of_sound_in_the_standard_atmosphere(fl, speed_of_sound_m_s):
    """ICAO Doc 7488; constant above the tropopause at 11 km."""
    m_s_per_kt = 1852.0 / 3600.0
    got = tas_from_mach(np.array([fl]), 1.0)[0] * m_s_per_kt
    assert got == pytest.approx(speed_of_sound_m_s, abs=1e-3)


@pytest.mark.parametrize("fl", [0, 100, 305, 399])
def test_rates_of_the_table(fl):
    assert rate_ft_min(MEDIUM, fl, CLIMB) == 2500.0
    assert rate_ft_min(MEDIUM, fl, CRUISE) == 0.0
    assert rate_ft_min(MEDIUM, fl, DESCENT) == -2500.0


@pytest.mark.parametrize("fl", [400, 401, 450])
def test_aircraft_do_not_climb_above_the_ceiling(fl):
    assert rate_ft_min(MEDIUM, fl, CLIMB) == 0.0
    assert rate_ft_min(MEDIUM, fl, DESCENT) == -2500.0


def test_airspeed_is_constant_above_the_last_level():
    assert airspeed_kt(MEDIUM, 700.0, CRUISE) == pytest.approx(458.855368, abs=1e-3)


@pytest.mark.parametrize("fl", [0, 100, 300, 400, 600])
@pytest.mark.parametrize("phase", [CLIMB, CRUISE, DESCENT])
def test_the_constant_model_is_constant(fl, phase):
    model = ConstantPerformance()
    assert airspeed_kt(model, fl, phase) == 400.0
    assert rate_ft_min(model, fl, phase) == phase * 2000.0
    assert airspeed_kt(ConstantPerformance(airspeed_kt=250.0), fl, phase) == 250.0


def test_arrays_are_evaluated_elementwise():
    levels, phases = np.meshgrid(np.array(LEVELS_FL), np.array(list(AIRSPEEDS_KT)))
    got = MEDIUM.true_airspeed_kt(
        array(*levels.ravel() * TICKS_PER_FL), array(*phases.ravel().astype(float))
    )
    assert got == pytest.approx(np.array(list(AIRSPEEDS_KT.values())).ravel(), abs=1e-3)


@pytest.mark.parametrize(
    ("name", "kind"), [("table", TablePerformance), ("constant", ConstantPerformance)]
)
def test_finds_models_by_name(name, kind):
    assert performance(name) == kind()


def test_refuses_an_unknown_model_and_suggests_the_nearest():
    with pytest.raises(InputError, match=r"'tabel'.*did you mean 'table'\?.*constant, table"):
        performance("tabel")


@pytest.mark.parametrize("fl", [0, 100, 102.5, 305, 600])
def test_levels_are_whole_ticks_exact_in_float32(fl):
    assert ticks(float(fl)) == fl * 6000.0
    assert float(np.float32(ticks(float(fl)))) == ticks(float(fl))


def test_a_tick_is_one_foot_per_minute_for_one_second():
    feet_per_tick = 100.0 / TICKS_PER_FL
    assert feet_per_tick * 60.0 == pytest.approx(1.0)
