"""Half a day of the thirty, and the clock of the tables over all of them."""

import numpy as np
from rich.console import Console

from skystack.airspace.sectors import sector_named
from skystack.platforms.flight import Flight, flight_rows
from skystack.platforms.protocol import Report
from skystack.simulator.performance import TablePerformance
from skystack.simulator.scenario_file import Aircraft, Scenario
from skystack.simulator.simulator import Simulator
from verification.simulator.thirty_days import AT_ONCE, BOUNDS, DAY, DAYS, worst

SILENT = Console(quiet=True)


def test_half_a_day_ends_where_it_must():
    simulator = Simulator(sector_named("x-plus"), TablePerformance())
    found = worst(simulator, AT_ONCE, SILENT)
    assert found["heading"] == 0.0
    assert found["level"] == 0.0
    assert found["back after a lap"] <= BOUNDS["back after a lap"][0]


def test_what_drifts_is_seen():
    """Turns that are too slow by a ten-thousandth, climbs by a fraction of a tick."""
    model = TablePerformance(rate_ft_min=2499.7)
    slow = Simulator(sector_named("x-plus"), model, turn_rate_deg_s=1.49985)
    found = worst(slow, AT_ONCE, SILENT)
    assert found["heading"] > 0.0
    # In each of 48 seconds rounded by 1/16 tick at most, and exact again at the level captured.
    assert 0.0 < found["level"] <= 3.0
    assert found["back after a lap"] > BOUNDS["back after a lap"][0]


def test_the_tables_time_is_six_seconds_a_cycle_after_thirty_days():
    route = sector_named("x-plus").routes[0]
    one = Aircraft("AC1", "B753", route, 0.0, 0.0, 300.0, 0.0, 300, False)
    scenario = Scenario(sector_named("x-plus"), "table", DAYS * DAY, (one,), ())
    here = Report(*np.zeros((len(Report._fields), 1)))
    rows = flight_rows(scenario, Flight([here] * (DAYS * DAY + 1), []))
    assert rows["cycle"].tolist() == list(range(DAYS * DAY + 1))
    assert rows["time_s"].tolist() == list(range(0, DAYS * 24 * 3600 + 1, 6))
