"""Half a day of the thirty, and the time in the tables over all thirty."""

import numpy as np
import pytest
from rich.console import Console

from skystack.airspace.sectors import sector_named
from skystack.platforms.flight import Flight, flight_rows
from skystack.platforms.protocol import Report
from skystack.simulator.performance import TablePerformance
from skystack.simulator.scenario_file import Aircraft, Scenario
from skystack.simulator.simulator import Simulator
from verification.simulator.thirty_days import AT_ONCE, BOUNDS, DAY, DAYS, worst

SILENT = Console(quiet=True)


@pytest.mark.slow
def test_nothing_drifts_in_half_a_day():
    simulator = Simulator(sector_named("x-plus"), TablePerformance())
    found = worst(simulator, AT_ONCE, SILENT)
    assert found["heading"] == 0.0
    assert found["level"] == 0.0
    assert found["back after a lap"] <= BOUNDS["back after a lap"][0]


def test_detects_drift():
    """Turns that are too slow by 0.01 %, and climbs by a fraction of a tick."""
    model = TablePerformance(rate_ft_min=2499.7)
    slow = Simulator(sector_named("x-plus"), model, turn_rate_deg_s=1.49985)
    found = worst(slow, AT_ONCE, SILENT)
    assert found["heading"] > 0.0
    # Rounded by at most 1/16 tick in each of 48 seconds, and exact when the level is captured.
    assert 0.0 < found["level"] <= 3.0
    assert found["back after a lap"] > BOUNDS["back after a lap"][0]


def test_time_is_six_seconds_per_cycle_over_thirty_days():
    route = sector_named("x-plus").routes[0]
    aircraft = Aircraft("AC1", "B753", route, 0.0, 0.0, 300.0, 0.0, 300, False)
    scenario = Scenario(sector_named("x-plus"), "table", DAYS * DAY, (aircraft,), ())
    report = Report(*np.zeros((len(Report._fields), 1)))
    rows = flight_rows(scenario, Flight([report] * (DAYS * DAY + 1), []))
    assert rows["cycle"].tolist() == list(range(DAYS * DAY + 1))
    assert rows["time_s"].tolist() == list(range(0, DAYS * 24 * 3600 + 1, 6))
