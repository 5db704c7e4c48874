"""What flown hours show of training objectives, on made clearances."""

import pyarrow as pa
import pytest

from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.traffic_conditions import TrafficConditions
from studies.training_objectives import main, spoken, table_of


def clearances(*rows):
    """Rows of scenario, cycle, transmission, callsign and kind."""
    names = ("scenario", "cycle", "transmission", "callsign", "kind")
    return pa.Table.from_pylist([dict(zip(names, row, strict=True)) for row in rows])


def test_counts_transmissions_not_clearances():
    """Five transmissions: AC1 twice within 60 s, AC2 once, AC1 again later and in another hour."""
    found = spoken(
        clearances(
            (0, 0, 0, "AC1", "heading"),
            (0, 0, 0, "AC1", "level"),
            (0, 4, 1, "AC2", "level"),
            (0, 10, 2, "AC1", "direct"),
            (0, 21, 3, "AC1", "level"),
            (1, 22, 0, "AC1", "level"),
        )
    )
    assert found.again_soon == pytest.approx(1 / 5)
    assert found.combined == pytest.approx(1 / 5)
    assert (found.level, found.heading, found.direct) == pytest.approx((4 / 5, 1 / 5, 1 / 5))


def test_nothing_was_transmitted():
    assert spoken(clearances((0, 0, 0, "AC1", "level")).slice(0, 0)) is None


def test_one_column_for_each_controller(tmp_path, capsys):
    conditions = TrafficConditions("60", cycles=40)
    folders = [
        fly_flight_school(agent, conditions, [0], tmp_path).folder
        for agent in ("no-op", "own-navigation-exit-level")
    ]
    table = table_of(folders)
    assert table.header[2:] == ("no-op", "own-navigation-exit-level")
    by_measure = {line[1]: line[2:] for line in table.rows}
    assert by_measure["transmissions direct to a fix"][1] == "100.0 %"
    assert by_measure["elements per transmission"][0] == "1.00"
    assert main([*map(str, folders)]) == 0
    assert capsys.readouterr().out.count("\n") == len(table.rows) + 2
    assert main([str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
