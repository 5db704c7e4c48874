"""The study of Flight School: what it flies, its tables and its figure."""

from functools import partial

import msgspec
import pytest

from skystack.evaluation.hour_row import write_row
from skystack.evaluation.traffic_conditions import TrafficConditions
from studies import flight_school
from studies.flight_school import Case
from tests.reporting.rows import hour_row


def test_flies_every_controller_on_every_traffic():
    plan = flight_school.plan()
    assert len(plan) == len(set(plan)) == 2 * 3 * 6 + 7
    assert Case("mvp", "category", "bluesky") in plan
    assert not [each for each in plan if each.agent == "mvp" and each.platform != "bluesky"]


def test_flies_prints_and_draws(tmp_path, capsys, monkeypatch):
    """With short hours of one controller."""
    monkeypatch.setattr(flight_school, "plan", lambda: [Case("no-op", "category", "skystack")])
    monkeypatch.setattr(flight_school, "TrafficConditions", partial(TrafficConditions, cycles=20))
    arguments = ["--seeds", "2", "--others", "1", "--out", str(tmp_path)]
    assert flight_school.main(arguments) == 0
    assert "### `category` in skystack" in (out := capsys.readouterr().out)
    assert "| no-op" in out
    assert (tmp_path / "flight-school.png").exists()
    assert flight_school.main(["--read", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out == out


def test_the_best_controller_comes_first(tmp_path, capsys):
    for agent, score in (("rules", 900.0), ("search", 3100.0)):
        row = hour_row(agent, "category", lax_s_mean=score, losses_per_flight_hour=0.5)
        (tmp_path / agent).mkdir()
        write_row(tmp_path / agent, msgspec.to_builtins(row))
    assert flight_school.main(["--read", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines if line.startswith("| ")][1:] == ["search", "rules"]


@pytest.mark.parametrize("arguments", [["--read"], ["--seeds", "0"], ["--others", "0"]])
def test_mistakes_are_one_line(tmp_path, capsys, arguments):
    assert flight_school.main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()
