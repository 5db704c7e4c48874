"""The study of Springfield's scenarios."""

import pytest

pytest.importorskip("bluebird_dt")

from msgspec.structs import replace

from studies import springfield
from tests.reporting.rows import hour_row


@pytest.mark.slow
def test_flies_every_scenario_under_every_agent(tmp_path, capsys, monkeypatch):
    """With short hours."""
    monkeypatch.setattr(springfield, "CYCLES", 20)
    monkeypatch.setattr(
        springfield, "run_pieces", lambda work, pieces, what: [work(*each) for each in pieces]
    )
    monkeypatch.setattr(springfield, "scenario_names", lambda: ["testScenario", "llm-scenario"])
    assert springfield.main(["no-op", "--platform", "skystack", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "| no-op" in printed
    assert len(list(tmp_path.glob("no-op-traffic-springfield-*/row.json"))) == 2


def test_rates_are_weighted_by_flights():
    """9 of 10 and 1 of 5 flights exit correctly, which is 10 of 15."""
    rows = [
        replace(
            hour_row("search", "springfield:x"),
            flights=flights,
            correct_exit_rate=rate,
            lax_s_mean=lax_s,
            losses_of_separation=1,
        )
        for flights, rate, lax_s in ((10, 0.9, 3600.0), (5, 0.2, 100.0))
    ]
    table = springfield.table(rows, ["search"])
    cells = dict(zip(table.header, table.rows[0], strict=True))
    assert cells["correct exits"] == "66.7 %"
    assert (cells["flights"], cells["losses of separation"]) == ("15", "2")
    assert (cells["scenarios"], cells["without a failure (lax score)"]) == ("2", "1")


def test_an_unknown_agent_is_refused(tmp_path, capsys):
    assert springfield.main(["serch", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()
