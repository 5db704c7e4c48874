"""The study of capacity: its table, its reuse of finished rows, and its errors."""

import json

import pytest

from skystack.evaluation.traffic import TrafficConditions
from studies import capacity

ROW = {
    "traffic": "60",
    "flights": 1234,
    "losses_of_separation": 3,
    "losses_at_birth": 1,
    "correct_exit_rate": 0.987,
    "excursion_rate": 0.001,
    "transmissions_per_flight": 2.345,
    "transmissions_worst_minute": 10,
    "fail_safe_rate": 0.91,
    "extra_miles_rate": 0.012,
    "lax_s_mean": 3456.7,
    "strict_s_mean": 1234.5,
    "decision_ms_median": 4.56,
}


def test_a_line_of_the_table_has_the_figures_of_a_row():
    found = capacity.table([ROW])
    assert dict(zip(found.header, found.rows[0], strict=True)) == {
        "traffic": "60",
        "flights": "1,234",
        "losses of separation (at birth)": "3 (1)",
        "correct exits": "98.7 %",
        "excursions": "0.1 %",
        "transmissions per flight": "2.35",
        "worst minute": "10",
        "fail-safe": "91.0 %",
        "extra distance": "1.2 %",
        "lax score, s": "3,457",
        "strict score, s": "1,234",
        "decision, ms": "4.6",
    }


def test_finished_rows_are_reused(tmp_path):
    conditions = TrafficConditions("60", 20, 1)
    (tmp_path / "search-60-20.json").write_text(json.dumps(ROW))
    assert capacity.row_of("search", conditions, tmp_path) == ROW


@pytest.mark.parametrize(
    "arguments", [["serch"], ["search", "--traffic", "0"], ["search", "--hours", "0"]]
)
def test_mistakes_are_refused_before_anything_is_flown(tmp_path, capsys, arguments):
    assert capacity.main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()
