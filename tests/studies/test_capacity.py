"""The study of capacity: its table, its reuse of finished rows, and its errors."""

from functools import partial

import msgspec
import pytest

from skystack.evaluation.hour_row import write_row
from skystack.evaluation.traffic import hours_folder
from skystack.evaluation.traffic_conditions import TrafficConditions
from studies import capacity
from tests.reporting.rows import hour_row


def test_finished_evaluations_are_reused(tmp_path):
    conditions = TrafficConditions("60", 2, 1)
    row = hour_row("search", "60")
    folder = hours_folder(tmp_path, "search", conditions)
    folder.mkdir()
    write_row(folder, msgspec.to_builtins(row))
    assert capacity.row_of("search", "search", conditions, tmp_path) == row


@pytest.mark.slow
def test_the_study_writes_a_page(tmp_path, capsys, monkeypatch):
    """With short hours."""
    monkeypatch.setattr(capacity, "TrafficConditions", partial(TrafficConditions, cycles=20))
    monkeypatch.setattr(
        capacity, "run_pieces", lambda work, pieces, what: [work(*each) for each in pieces]
    )
    arguments = ["no-op", "--traffic", "60", "--hours", "1", "--out", str(tmp_path)]
    assert capacity.main(arguments) == 0
    assert "| no-op" in capsys.readouterr().out
    assert (tmp_path / "hours.html").exists()
    assert (tmp_path / "no-op-traffic-60-seed-1" / "row.json").exists()


@pytest.mark.parametrize(
    "arguments", [["serch"], ["search", "--traffic", "0"], ["search", "--hours", "0"]]
)
def test_mistakes_are_refused_before_anything_is_flown(tmp_path, capsys, arguments):
    assert capacity.main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()
