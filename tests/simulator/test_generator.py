"""Random scenarios against the distributions in the paper's table of parameters."""

from functools import cache

import jax
import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.simulator.entries import first_fixes
from skystack.simulator.generator import LateralScenarios
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import NO_TURN

from .flights import flights, geodesic_nm

SCENARIOS = 20_000
FIRST_FIX = np.array([route[0] for route in x_plus().routes])
FIRST_HEADINGS = {"ROBIN": 284.9040, "HERON": 45.1920, "PEL": 134.8089, "SWIFT": 225.1904}


@cache
def scenarios(aircraft=2):
    """The traffic of many scenarios, `[scenario, aircraft]`."""
    lateral = LateralScenarios(flights("table").simulator, aircraft=aircraft)
    keys = jax.random.split(jax.random.key(7), SCENARIOS)
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(lateral.draw))(keys).traffic)


def offset_nm(traffic):
    """Positions relative to the first fixes, in true lengths."""
    fixes = x_plus().route_table.fixes_nm[traffic.route, 0]
    return (traffic.position_nm - fixes) / x_plus().plane.scale(fixes[..., 1:])


@pytest.mark.parametrize("aircraft", [2, 3, 4])
def test_first_fixes_differ(aircraft):
    first = FIRST_FIX[scenarios(aircraft).route]
    assert all(len(set(fixes)) == aircraft for fixes in first)


def test_the_sector_has_four_first_fixes():
    assert first_fixes(flights("table").simulator.sector) == 4


def test_positions_lie_within_4_nm_of_the_first_fix():
    traffic = scenarios()
    assert np.linalg.norm(offset_nm(traffic), axis=-1).max() <= 4.0 + 1e-4
    sector = x_plus()
    fixes = np.array([sector.fixes[name] for name in FIRST_FIX])[traffic.route]
    lat_lon = sector.plane.to_degrees(traffic.position_nm)
    assert geodesic_nm(lat_lon, fixes).max() <= 4.0 + 5e-4


def test_positions_are_uniform_in_the_disc():
    """r^2 is uniform in [0, 16] (mean 8) and the direction uniform: each within 4 sigma."""
    offset = offset_nm(scenarios()).reshape(-1, 2)
    n = len(offset)
    r2 = np.sum(offset**2, axis=-1)
    assert r2.mean() == pytest.approx(8.0, abs=4.0 * 16.0 / np.sqrt(12.0 * n))
    gap = np.sort(r2) / 16.0 - (np.arange(n) + 0.5) / n
    assert np.max(np.abs(gap)) < 2.0 / np.sqrt(n)  # Kolmogorov-Smirnov
    for harmonic in (1, 2):
        angle = harmonic * np.arctan2(offset[:, 0], offset[:, 1])
        assert np.hypot(np.cos(angle).mean(), np.sin(angle).mean()) < 4.0 / np.sqrt(n)


def test_positions_of_the_aircraft_are_independent():
    first, second = np.moveaxis(offset_nm(scenarios()), 1, 0)
    for a in first.T:
        for b in second.T:
            assert abs(np.corrcoef(a, b)[0, 1]) < 4.0 / np.sqrt(SCENARIOS)


def test_headings_are_those_of_the_first_leg():
    traffic = scenarios()
    expected = np.array([FIRST_HEADINGS[name] for name in FIRST_FIX])[traffic.route]
    assert traffic.heading_deg == pytest.approx(expected, abs=1e-4)


def test_aircraft_start_in_level_flight_at_fl300():
    traffic = scenarios()
    assert (traffic.level_ticks == 300.0 * TICKS_PER_FL).all()
    assert traffic.ground_speed_kt == pytest.approx(465.940793, abs=1e-3)
    assert (traffic.vertical_speed_ft_min == 0.0).all()
    assert (traffic.cleared_heading_deg == traffic.heading_deg).all()
    assert (traffic.cleared_level_ticks == traffic.level_ticks).all()
    assert (traffic.flown_heading_deg == traffic.heading_deg).all()
    assert (traffic.flown_level_ticks == traffic.level_ticks).all()
    assert (traffic.pending_turn == NO_TURN).all()
    assert (traffic.turn_deg == 0.0).all()
    assert (traffic.next_fix == 1).all()
    assert traffic.active.all()
    assert not traffic.own_navigation.any()


def test_route_frequencies():
    """The first route is uniform over all, the second over those that start elsewhere."""
    n = len(FIRST_FIX)
    elsewhere = FIRST_FIX[:, None] != FIRST_FIX[None, :]
    pairs = elsewhere / elsewhere.sum(axis=1, keepdims=True) / n
    route = scenarios().route
    counted = np.zeros((n, n))
    np.add.at(counted, (route[:, 0], route[:, 1]), 1.0)
    sigma = np.sqrt(pairs * (1.0 - pairs) * SCENARIOS)
    assert (counted[~elsewhere] == 0.0).all()
    assert np.all(np.abs(counted - pairs * SCENARIOS)[elsewhere] < 4.5 * sigma[elsewhere])


def test_each_aircraft_flies_every_route():
    for routes in scenarios().route.T:
        assert set(routes.tolist()) == set(range(10))


def test_scenarios_depend_only_on_the_key():
    lateral = LateralScenarios(flights("table").simulator)
    draw = jax.jit(lambda key: lateral.draw(key).traffic)
    once, again = draw(jax.random.key(3)), draw(jax.random.key(3))
    for a, b in zip(once, again, strict=True):
        assert np.array_equal(a, b)
    assert not np.array_equal(once.position_nm, draw(jax.random.key(4)).position_nm)


def test_draws_scenarios_with_the_given_settings():
    lateral = LateralScenarios(
        flights("constant").simulator, aircraft=3, levels_fl=(250,), disc_nm=1.0
    )
    traffic = jax.jit(lateral.draw)(jax.random.key(0)).traffic
    assert traffic.level_ticks.tolist() == [250.0 * TICKS_PER_FL] * 3
    assert traffic.ground_speed_kt.tolist() == [400.0] * 3
    assert np.linalg.norm(offset_nm(jax.tree.map(np.asarray, traffic)), axis=-1).max() <= 1.0
