"""Conversion of reports to traffic, and of traffic to scenarios."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning.seeds import scenario_key
from skystack.platforms.conversion import scenario_of, traffic_of
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Report
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import NO_TURN, RIGHT
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

TASK = build_task(NavigationSettings())
PLANE = TASK.simulator.sector.plane


def report(**changes):
    fields = {
        "lat": [0.1, 0.2],
        "lon": [-0.3, 0.4],
        "fl": [300.0, 319.99999999],
        "heading_deg": [45.5, 271.25],
        "cleared_heading_deg": [60.0, 270.0],
        "cleared_fl": [340.0, 320.0],
        "ground_speed_kt": [465.9, 451.2],
        "vertical_speed_ft_min": [2500.0, -2500.0],
    }
    return Report(**{name: np.array(values) for name, values in (fields | changes).items()})


def drawn_traffic():
    return TASK.scenarios.draw(scenario_key(0, 3)).traffic


def test_traffic_has_the_reported_values():
    before = drawn_traffic()
    traffic = traffic_of(report(), before, PLANE)
    np.testing.assert_allclose(PLANE.to_degrees(traffic.position_nm)[:, 0], [0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(PLANE.to_degrees(traffic.position_nm)[:, 1], [-0.3, 0.4], atol=1e-6)
    # Rounding to ticks removes the floating-point noise of a captured level.
    assert traffic.level_ticks.tolist() == [300 * TICKS_PER_FL, 320 * TICKS_PER_FL]
    assert traffic.cleared_level_ticks.tolist() == [340 * TICKS_PER_FL, 320 * TICKS_PER_FL]
    assert traffic.cleared_heading_deg.tolist() == [60.0, 270.0]
    assert traffic.route.tolist() == before.route.tolist()
    same_dtype = jax.tree.map(lambda new, old: new.dtype == old.dtype, traffic, before)
    assert all(jax.tree.leaves(same_dtype))


def test_inactive_aircraft_stay_unchanged():
    before = drawn_traffic()._replace(active=jax.numpy.array([False, True]))
    traffic = traffic_of(report(), before, PLANE)
    assert traffic.position_nm[0].tolist() == before.position_nm[0].tolist()
    assert traffic.level_ticks[0] == before.level_ticks[0]
    assert traffic.level_ticks[1] == 320 * TICKS_PER_FL
    assert traffic.active.tolist() == [False, True]


def test_platform_starts_with_the_drawn_traffic():
    before = drawn_traffic()
    callsigns = ["AC1", "AC2"]
    scenario = scenario_of(before, TASK.simulator, "table", 300, callsigns, before.level_ticks)
    start = traffic_of(Skystack().reset(scenario), before, PLANE)
    for name, old in before._asdict().items():
        if old is None:  # an optional field
            assert getattr(start, name) is None
            continue
        np.testing.assert_allclose(getattr(start, name), old, rtol=1e-6, atol=1e-5, err_msg=name)
    assert [one.callsign for one in scenario.aircraft] == callsigns
    routes = TASK.simulator.sector.routes
    assert [one.route for one in scenario.aircraft] == [routes[i] for i in before.route]


def test_clearances_count_as_adopted():
    """Nothing is pending, and the rest of a turn is the shorter way to the cleared heading."""
    in_progress = {
        "pending_turn": RIGHT,
        "turn_deg": 30.0,
        "turn_radius_nm": 5.0,
        "flown_level_ticks": 1.0,
    }
    original = drawn_traffic()
    before = original._replace(
        **{
            name: jnp.full_like(getattr(original, name), value)
            for name, value in in_progress.items()
        }
    )
    traffic = traffic_of(report(), before, PLANE)
    assert (
        traffic.flown_heading_deg.tolist() == traffic.cleared_heading_deg.tolist() == [60.0, 270.0]
    )
    assert traffic.flown_level_ticks.tolist() == [340 * TICKS_PER_FL, 320 * TICKS_PER_FL]
    assert traffic.turn_deg.tolist() == [60.0 - 45.5, 270.0 - 271.25]
    assert traffic.turn_radius_nm.tolist() == [0.0, 0.0]
    assert traffic.pending_turn.tolist() == [NO_TURN, NO_TURN]
    assert traffic.heading_deg.tolist() == [45.5, 271.25]
    assert traffic.vertical_speed_ft_min.tolist() == [2500.0, -2500.0]
    np.testing.assert_allclose(traffic.ground_speed_kt, [465.9, 451.2], rtol=1e-6)


def test_rounds_levels_to_the_nearest_tick():
    tick = 1.0 / TICKS_PER_FL
    levels = [300.0 + 0.4 * tick, 300.0 + 0.6 * tick]
    traffic = traffic_of(report(fl=levels, cleared_fl=levels[::-1]), drawn_traffic(), PLANE)
    assert (traffic.level_ticks - 300 * TICKS_PER_FL).tolist() == [0.0, 1.0]
    assert (traffic.cleared_level_ticks - 300 * TICKS_PER_FL).tolist() == [1.0, 0.0]


def test_each_aircraft_keeps_its_route_levels_and_type():
    """Exit levels that differ from the initial ones, types of a fleet, and own navigation."""
    kinds = (AircraftType(), AircraftType("AT76", mach=(0.4, 0.4, 0.4)), AircraftType("A320"))
    task = build_task(NavigationSettings(fleet=kinds))
    traffic = task.scenarios.draw(scenario_key(0, 3)).traffic._replace(
        kind=jnp.array([2, 1], dtype=jnp.int32),
        level_ticks=jnp.array([300.5, 280.0], dtype=jnp.float32) * TICKS_PER_FL,
        own_navigation=jnp.array([False, True]),
        heading_deg=jnp.array([12.5, 350.0], dtype=jnp.float32),
    )
    exit_level_ticks = np.array([220.0, 360.0]) * TICKS_PER_FL
    scenario = scenario_of(traffic, task.simulator, "table", 77, ["X1", "Y2"], exit_level_ticks)
    routes = task.sector.routes
    names = ("callsign", "type", "route", "fl", "heading_deg", "exit_fl", "own_navigation")
    assert [tuple(getattr(one, name) for name in names) for one in scenario.aircraft] == [
        ("X1", "A320", routes[traffic.route[0]], 300.5, 12.5, 220, False),
        ("Y2", "AT76", routes[traffic.route[1]], 280.0, 350.0, 360, True),
    ]
    assert (scenario.performance, scenario.cycles, scenario.clearances) == ("table", 77, ())
    assert scenario.fleet == kinds
    assert scenario.sector is task.sector


@pytest.mark.parametrize("fl", [229.9999, 230.0001])
def test_rounds_exit_levels_to_whole_flight_levels(fl):
    """Ticks are float32, so the quotient may be slightly off a whole level."""
    exit_level_ticks = np.full(2, fl * TICKS_PER_FL)
    scenario = scenario_of(
        drawn_traffic(), TASK.simulator, "table", 9, ["AC1", "AC2"], exit_level_ticks
    )
    assert [one.exit_fl for one in scenario.aircraft] == [230, 230]
