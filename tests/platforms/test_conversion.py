"""Reports as the traffic that tasks read: whole levels, and who has left stays where it was."""

import jax
import numpy as np

from skystack.platforms.conversion import scenario_of, traffic_of
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Report
from skystack.seeds import scenario_key
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.build import build_task
from skystack.tasks.settings import TaskSettings

TASK = build_task(TaskSettings())
PLANE = TASK.simulator.sector.plane


def report(**changes):
    two = {
        "lat": [0.1, 0.2],
        "lon": [-0.3, 0.4],
        "fl": [300.0, 319.99999999],
        "heading_deg": [45.5, 271.25],
        "cleared_heading_deg": [60.0, 270.0],
        "cleared_fl": [340.0, 320.0],
        "ground_speed_kt": [465.9, 451.2],
        "vertical_speed_ft_min": [2500.0, -2500.0],
    }
    return Report(**{name: np.array(values) for name, values in (two | changes).items()})


def drawn():
    return TASK.scenarios.draw(scenario_key(0, 3)).traffic


def test_a_report_is_read_as_it_stands():
    before = drawn()
    read = traffic_of(report(), before, PLANE)
    np.testing.assert_allclose(PLANE.to_degrees(read.position_nm)[:, 0], [0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(PLANE.to_degrees(read.position_nm)[:, 1], [-0.3, 0.4], atol=1e-6)
    # Floating-point noise of a level that was captured is none any more.
    assert read.level.tolist() == [300 * TICKS_PER_FL, 320 * TICKS_PER_FL]
    assert read.cleared_level.tolist() == [340 * TICKS_PER_FL, 320 * TICKS_PER_FL]
    assert read.cleared_heading_deg.tolist() == [60.0, 270.0]
    assert read.route.tolist() == before.route.tolist()
    same = jax.tree.map(lambda new, old: new.dtype == old.dtype, read, before)
    assert all(jax.tree.leaves(same))


def test_who_has_left_stays_as_it_was():
    before = drawn()._replace(active=jax.numpy.array([False, True]))
    read = traffic_of(report(), before, PLANE)
    assert read.position_nm[0].tolist() == before.position_nm[0].tolist()
    assert read.level[0] == before.level[0]
    assert read.level[1] == 320 * TICKS_PER_FL
    assert read.active.tolist() == [False, True]


def test_a_drawn_scenario_begins_on_a_platform_where_it_was_drawn():
    before = drawn()
    callsigns = ["AC1", "AC2"]
    scenario = scenario_of(before, TASK.simulator, "table", 300, callsigns, before.level)
    start = traffic_of(Skystack().reset(scenario), before, PLANE)
    for name, old in before._asdict().items():
        np.testing.assert_allclose(getattr(start, name), old, rtol=1e-6, atol=1e-5, err_msg=name)
    assert [one.callsign for one in scenario.aircraft] == callsigns
    routes = TASK.simulator.sector.routes
    assert [one.route for one in scenario.aircraft] == [routes[i] for i in before.route]
