"""The simulator benchmark times the work that it names."""

import jax
import numpy as np
import pytest

from skystack.airspace.geometry import distance_right_of_route, points_of
from skystack.benchmarking.simulator import Stepper, task_of


@pytest.mark.slow
@pytest.mark.parametrize("aircraft", [2, 10, 50])
def test_every_aircraft_is_observed_and_moves(aircraft):
    task = task_of(aircraft)
    assert len(task.observation_names) == 4 * aircraft
    assert len(task.action_names) == 1 + 2 * aircraft
    stepper = Stepper(task, scenarios=3)
    before = np.asarray(stepper.state.traffic.position_nm)
    assert before.shape == (aircraft, 2, 3)
    stepper.run()
    moved = np.asarray(stepper.state.traffic.position_nm) - before
    assert (np.hypot(moved[:, 0], moved[:, 1]) > 1.0).mean() > 0.9


@pytest.mark.slow
def test_many_aircraft_fly_along_their_routes():
    """At the start all are on a centreline, level and heading along it, on several routes."""
    task = task_of(50)
    drawn = jax.jit(task.scenarios.draw)(jax.random.key(0))
    table = task.simulator.sector.route_table
    fixes = points_of(table.fixes_nm, drawn.traffic.route)
    offset_nm = distance_right_of_route(drawn.traffic.position_nm, fixes)
    assert np.abs(offset_nm).max() < 1e-3
    advanced = jax.jit(task.simulator.advance)(drawn.traffic)
    advanced_offset_nm = distance_right_of_route(advanced.position_nm, fixes)
    assert np.mean(np.abs(advanced_offset_nm) < 0.01) > 0.9  # the others are past a bend
    assert len(set(np.asarray(drawn.traffic.route).tolist())) > 5
    assert np.array_equal(drawn.exit_level_ticks, drawn.traffic.level_ticks)
