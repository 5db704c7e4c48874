"""The work that is timed is the work that is named."""

import jax
import numpy as np
import pytest

from skystack.airspace.geometry import distance_right_of_route, points_of
from skystack.benchmarking.simulator import Stepper, task_of


@pytest.mark.parametrize("aircraft", [2, 10, 50])
def test_every_aircraft_is_there_observed_and_moves(aircraft):
    task = task_of(aircraft)
    assert len(task.observation_names) == 4 * aircraft
    assert len(task.action_names) == 1 + 2 * aircraft
    stepper = Stepper(task, scenarios=3)
    before = np.asarray(stepper.state.traffic.position_nm)
    assert before.shape == (aircraft, 2, 3)
    stepper.run()
    moved = np.asarray(stepper.state.traffic.position_nm) - before
    assert (np.hypot(moved[:, 0], moved[:, 1]) > 1.0).mean() > 0.9


def test_a_crowd_flies_along_its_routes():
    """At the start everybody is on the centreline, level, pointing along it; not all on one."""
    task = task_of(50)
    drawn = jax.jit(task.scenarios.draw)(jax.random.key(0))
    table = task.simulator.sector.route_table
    fixes = points_of(table.fixes_nm, drawn.traffic.route)
    aside = distance_right_of_route(drawn.traffic.position_nm, fixes)
    assert np.abs(aside).max() < 1e-3
    ahead = jax.jit(task.simulator.advance)(drawn.traffic)
    still = distance_right_of_route(ahead.position_nm, fixes)
    assert np.mean(np.abs(still) < 0.01) > 0.9  # the others have passed a bend
    assert len(set(np.asarray(drawn.traffic.route).tolist())) > 5
    assert np.array_equal(drawn.exit_level_ticks, drawn.traffic.level_ticks)
