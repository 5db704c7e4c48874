"""Flows of arrivals: what is drawn, and how many flights BluebirdDT's clocks let in.

The expected numbers of `category` were measured on BluebirdDT 0.4.0: `Infinite.setup` with the
rates of its Flight School, random seeds 0 to 7, without instructions. The rate of `notebook` is
its measured one.
"""

from collections import Counter
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from skystack.airspace.sectors import sector_named
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.simulator.arrival_flows import (
    FLIGHT_SCHOOL,
    HOUR_CYCLES,
    STARTERS,
    Flow,
    constant_rate,
)
from skystack.simulator.arrivals import FREE, fly, release
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator

SIMULATOR = Simulator(x_plus(), performance("constant"), own_navigation=True)
HOURS = 12
FAR_NM = 20.0
"""BluebirdDT removes a flight this far outside the bounding box of the area and the fixes."""


@cache
def hours(name):
    """The number of flights born, and of those present, after each cycle, `[hours, cycles]`."""
    clock = FLIGHT_SCHOOL.get(name) or constant_rate(float(name))
    flow = Flow(SIMULATOR, clock, starters=STARTERS if name in FLIGHT_SCHOOL else 0)
    points = np.stack([*SIMULATOR.sector.area_nm, *SIMULATOR.sector.fixes_nm.values()])
    low, high = points.min(axis=0) - FAR_NM, points.max(axis=0) + FAR_NM

    def cycle(state, _):
        arrivals, traffic = fly(SIMULATOR, *flow.admission.admit(*state))
        outside = (traffic.position_nm < low[None]) | (traffic.position_nm > high[None])
        far = traffic.active & jnp.any(outside, axis=1)
        state = release(arrivals, traffic, far)
        return state, (state[0].born, jnp.sum(state[1].active), state[0].refused)

    def hour(key):
        return jax.lax.scan(cycle, flow.draw(key), None, length=HOUR_CYCLES)[1]

    keys = jax.random.split(jax.random.key(7), HOURS)
    return jax.device_get(jax.jit(jax.vmap(hour))(keys))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "time_s", "flights", "tolerance"),
    [
        ("category", 300, 15.6, 4),
        ("category", 600, 43.0, 5),
        ("category", 900, 71.1, 6),
        ("category", 1800, 130.1, 7),
        ("category", 3600, 261.0, 9),
        ("notebook", 3600, 0.031 * 3600, 8),
        ("200", 3600, 200, 13),
    ],
)
def test_the_number_of_flights(name, time_s, flights, tolerance):
    """The tolerance is about three standard errors of the mean over the hours."""
    born, _, _ = hours(name)
    assert born[:, time_s // 6 - 1].mean() == pytest.approx(flights, abs=tolerance)


@pytest.mark.slow
def test_a_dense_sector_refuses_births():
    _, present, refused = hours("category")
    assert present[:, 200:].mean() == pytest.approx(89.5, abs=4)
    assert refused[:, -1].min() > 10


@pytest.mark.slow
@pytest.mark.parametrize("sector", ["x-plus", "highland"])
def test_candidates_are_drawn_as_described(sector):
    place = sector_named(sector)
    simulator = Simulator(place, performance("constant"), own_navigation=True)
    flow = Flow(simulator, constant_rate(60.0), candidates=20_000)
    drawn = jax.device_get(flow.draw(jax.random.key(1))[0].candidates)
    table = place.route_table
    counts = Counter(drawn.route.tolist())
    assert chisquare([counts[route] for route in range(len(place.routes))]).pvalue > 1e-4
    fix = table.fixes_nm[drawn.route, 0].astype(float)
    scale = np.asarray(place.plane.scale(fix[:, 1]))
    heading = np.radians(table.first_heading_deg[drawn.route])
    along = np.stack([np.sin(heading), np.cos(heading)], axis=1)
    offset = (drawn.position_nm - fix) / scale[:, None]
    behind = np.sum(offset * along, axis=1)
    np.testing.assert_allclose(behind, -10.0, atol=1e-3)
    right = offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]
    for route in range(len(place.routes)):
        edge = place.edge_through(place.routes[route][0])
        half = np.hypot(*(edge[-1] - edge[0])) / place.plane.scale(edge[:1, 1])[0] / 2.0
        half = min(half, 10.0)  # large sectors have long edges
        mine = right[drawn.route == route] / half
        assert kstest(mine, "uniform", (-1.0, 2.0)).pvalue > 1e-4
    np.testing.assert_allclose(drawn.heading_deg, table.first_heading_deg[drawn.route])
    lowest, highest = place.levels_fl
    levels = np.arange(lowest, highest + 1, 10) * 6000.0
    for drawn_levels in (drawn.entry_level_ticks, drawn.exit_level_ticks):
        number = Counter(drawn_levels.tolist())
        assert set(number) == set(levels.tolist())
        assert chisquare(list(number.values())).pvalue > 1e-4
    same = np.mean(drawn.entry_level_ticks == drawn.exit_level_ticks)
    assert same == pytest.approx(1.0 / len(levels), abs=0.01)  # drawn independently
    assert kstest(400.0 * drawn.airspeed_factor, "uniform", (350.0, 100.0)).pvalue > 1e-4
    np.testing.assert_array_equal(drawn.climb_factor, 1.0)


@pytest.mark.slow
def test_uncertainty_changes_speeds_and_rates_within_its_range():
    flow = Flow(SIMULATOR, constant_rate(60.0), speeds_kt=(400.0, 400.0), speed_spread=0.03)
    drawn = flow.draw(jax.random.key(1))[0].candidates
    assert kstest(np.asarray(drawn.airspeed_factor), "uniform", (0.97, 0.06)).pvalue > 1e-4
    flow = Flow(SIMULATOR, constant_rate(60.0), climb_spread=0.1)
    drawn = flow.draw(jax.random.key(1))[0].candidates
    assert kstest(np.asarray(drawn.climb_factor), "uniform", (0.9, 0.2)).pvalue > 1e-4


@pytest.mark.slow
def test_starters_are_on_different_first_fixes():
    flow = Flow(SIMULATOR, FLIGHT_SCHOOL["category"], starters=STARTERS)
    draw = jax.jit(flow.draw)
    table, routes = SIMULATOR.sector.route_table, SIMULATOR.sector.routes
    for seed in range(8):
        arrivals, traffic = draw(jax.random.key(seed))
        assert arrivals.flight.tolist()[:3] == [0, 1, FREE]
        assert int(arrivals.born) == STARTERS
        first, second = np.asarray(traffic.route[:2]).tolist()
        assert routes[first][0] != routes[second][0]
        for slot, seconds in ((0, 0.0), (1, 1.0)):  # the second one starts a second later
            heading = np.radians(table.first_heading_deg[int(traffic.route[slot])])
            offset = (
                np.asarray(traffic.position_nm[slot]) - table.fixes_nm[int(traffic.route[slot]), 0]
            )
            behind = -(offset[0] * np.sin(heading) + offset[1] * np.cos(heading))
            speed = float(traffic.ground_speed_kt[slot]) / 3600.0
            assert behind == pytest.approx(seconds * speed, abs=2e-3)


@pytest.mark.parametrize("rate", [0.0, -1.0, 2000.0, float("nan")])
def test_rejects_impossible_rates(rate):
    with pytest.raises(InputError, match=r"flights per hour is .*allowed: above 0, at most 1000"):
        constant_rate(rate)
