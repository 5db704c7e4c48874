"""All flights of a scenario are there at the start, in its slots, and nobody arrives later."""

import jax
import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.simulator.arrivals import FREE, Clock
from skystack.simulator.drawn_flow import DrawnFlow
from skystack.simulator.generator import LateralScenarios
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator

SIMULATOR = Simulator(x_plus(), performance("table"), own_navigation=True)
SCENARIOS = LateralScenarios(SIMULATOR, aircraft=3, levels_fl=(280, 300))
FLOW = DrawnFlow(SIMULATOR, Clock(0.0), slots=5, cycles=10, scenarios=SCENARIOS, names=("A", "B"))
KEY = jax.random.key(7)


@pytest.fixture(scope="module")
def start():
    return FLOW.draw(KEY)


@pytest.mark.slow
def test_the_flights_are_those_of_the_scenario(start):
    arrivals, traffic = start
    drawn = SCENARIOS.draw(KEY)
    for name, values in drawn.traffic._asdict().items():
        if values is not None:
            np.testing.assert_array_equal(getattr(traffic, name)[:3], values, err_msg=name)
    np.testing.assert_array_equal(arrivals.exit_level_ticks[:3], drawn.exit_level_ticks)
    np.testing.assert_array_equal(arrivals.entry_level_ticks[:3], drawn.traffic.level_ticks)
    assert arrivals.flight.tolist() == [0, 1, 2, FREE, FREE]
    assert traffic.active.tolist() == [True] * 3 + [False] * 2
    assert arrivals.in_contact[:3].all()


@pytest.mark.slow
def test_they_fly_like_the_scenario_alone(start):
    arrivals, traffic = start
    alone = SCENARIOS.draw(KEY).traffic
    for _ in range(3):
        arrivals, traffic = FLOW.fly(arrivals, traffic)
        alone = SIMULATOR.advance(alone)
    np.testing.assert_array_equal(traffic.position_nm[:3], alone.position_nm)


def test_nobody_arrives(start):
    arrivals, traffic = start
    late = arrivals._replace(cycle=arrivals.cycle + 500)
    admitted, _ = FLOW.admission.admit(late, traffic)
    assert int(admitted.born) == 3
    assert int(admitted.waiting) == 0
