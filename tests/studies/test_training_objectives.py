"""What flown hours show of training objectives."""

import pytest

from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.reporting.tables import NOTHING
from studies.hour_results import result_in
from studies.training_objectives import main, table_of


@pytest.mark.slow
def test_one_column_for_each_controller(tmp_path, capsys):
    conditions = TrafficConditions("60", cycles=40)
    folders = [
        fly_flight_school(agent, conditions, [0], tmp_path).folder
        for agent in ("no-op", "own-navigation-exit-level")
    ]
    table = table_of([result_in(each) for each in folders])
    assert table.header[2:] == ("no-op", "own-navigation-exit-level")
    by_measure = {line[1]: line[2:] for line in table.rows}
    assert by_measure["transmissions direct to a fix"][1] == "100.0 %"
    assert by_measure["elements per transmission"][0] == NOTHING
    assert main([*map(str, folders)]) == 0
    assert capsys.readouterr().out.count("\n") == len(table.rows) + 2
    assert main([str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
