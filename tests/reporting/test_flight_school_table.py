"""The table of Flight School results."""

from skystack.reporting.flight_school_table import comparison, flight_school_table, survival_text
from skystack.reporting.tables import NOTHING
from tests.reporting.rows import hour_row

ROW = {
    "agent": "search", "traffic": "60", "platform": "bluebird",
    "seeds": 4, "seed_numbers": [1, 2, 3, 5], "failed_seeds": [4], "cycles": 600,
    "lax_s_mean": 2400.0, "lax_s_by_seed": [600.0, 1800.0, 3600.0, 3600.0],
    "lax_s_interval": (1000.0, 3800.0), "lax_without_births_s_mean": 3000.0,
    "lax_ended_by": {"loss at birth": 1, "excursion": 1},
    "strict_s_mean": 900.0, "strict_s_by_seed": [600.0] * 3 + [1800.0],
    "strict_s_interval": (0.0, 1800.0),
    "strict_ended_by": {"wrong exit level": 4},
    "deliveries": 1200, "flights_gone": 1210, "losses_of_separation": 3, "losses_at_birth": 2,
    "losses_per_flight_hour": 0.01234, "excursion_rate": 0.001, "transmissions_per_flight": 1.456,
    "transmissions_per_minute": 7.25, "decision_ms_median": 4.2, "decision_ms_p99": 30.0,
}  # fmt: skip


def test_shows_scores_survival_and_causes():
    values = {name.strip(): value for name, value in flight_school_table(ROW).rows}
    assert values["controller"] == "search"
    assert values["traffic"] == "60 flights/h, in bluebird"
    assert values["hours of traffic, 3,600 s each"] == "4 (+ 1 failed)"
    assert values["seeds"] == "1 to 3, 5"
    assert values["lax score, s"] == "2,400 ± 1,400 (600 to 3,600)"
    assert values["without losses at birth"] == "3,000"
    assert values["hours without a failure (lax)"] == "2 of 4"
    assert values["hours ended by (lax)"] == "loss at birth 1, excursion 1"
    assert values["survival (%) at 10 20 30 40 50 60 min"] == "100 75 75 50 50 50"
    assert values["correct exits, of flights that left"] == "1,200 of 1,210"
    assert values["losses of separation (at birth)"] == "3 (2)"


def test_the_comparison_shows_failed_seeds():
    assert comparison([hour_row("search", "60", failed_seeds=[4])]).rows[0][1] == "2 (+ 1 failed)"


def test_strict_shows_the_survival_of_the_strict_score():
    values = dict(flight_school_table(ROW, strict=True).rows)
    assert values["hours ended by (strict)"] == "wrong exit level 4"
    assert values["survival (%) at 10 20 30 40 50 60 min"] == "100 25 25 0 0 0"


def test_one_seed_has_no_interval():
    one = ROW | {"lax_s_interval": None, "strict_s_interval": None, "lax_ended_by": {}}
    values = dict(flight_school_table(one).rows)
    assert values["lax score, s"] == "2,400"
    assert values["hours ended by (lax)"] == NOTHING


def test_an_hour_survives_until_its_score():
    assert survival_text([600.0, 1200.0], [600.0, 606.0, 1200.0, 1206.0], 0) == "100 50 50 0"


def test_a_failure_in_the_last_cycle_counts():
    late = ROW | {"lax_ended_by": {"loss at birth": 1, "excursion": 1, "loss": 1}}
    values = dict(flight_school_table(late).rows)
    assert values["hours without a failure (lax)"] == "1 of 4"
    assert values["survival (%) at 10 20 30 40 50 60 min"] == "100 75 75 50 50 25"
