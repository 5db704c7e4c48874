"""The figures of sector control describe the work that is timed."""

import jax
import numpy as np
import pytest

from skystack.benchmarking import sector
from skystack.benchmarking.sector import RATE, SLOTS
from skystack.learning.experiment import load_experiment
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.tasks.registry import build_task
from skystack.tasks.sector_world import World


@pytest.fixture(autouse=True)
def small(monkeypatch):
    for name, value in {"WARM_UP": 20, "CYCLES": 3, "SCENARIOS": 2}.items():
        monkeypatch.setattr(sector, name, value)


@pytest.mark.slow
def test_counts_the_flights_of_the_cycles_that_are_timed():
    simulator = build_task(load_experiment(sector.EXPERIMENT).task).simulator
    world = World(Flow(simulator, constant_rate(RATE), slots=SLOTS))
    start, flights = sector._filled(world)
    state, counted = start, 0
    advance = jax.jit(world.advance)
    for _ in range(3):
        counted += int(np.sum(state.traffic.active))
        state, _ = advance(state)
    assert np.asarray(start.arrivals.cycle).tolist() == [20, 20]
    assert flights == counted > 0


@pytest.mark.slow
def test_names_what_is_timed():
    """Training and decisions are not timed here: their programs take a minute to compile."""
    figures = sector.traffic_figures(2)
    assert [each.name for each in figures] == [
        "sector traffic",
        "sector outlook",
        "sector control, observed",
    ]
    assert all(each.unit == "aircraft-steps/s" and len(each.values) == 2 for each in figures)
    assert all(value > 0.0 for each in figures for value in each.values)
    assert f"on {SLOTS} slots" in figures[0].configuration
