"""What flown hours show of training objectives."""

import pytest

from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING
from studies import training_objectives
from studies.hour_results import result_in, write_results
from studies.training_objectives import main, table_of
from tests.studies.test_hour_results import result


@pytest.mark.slow
def test_one_column_for_each_controller(tmp_path, capsys):
    conditions = TrafficConditions("60", cycles=40)
    folders = [
        fly_flight_school(agent, conditions, [0], tmp_path).folder
        for agent in ("no-op", "own-navigation-exit-level")
    ]
    table = table_of([result_in(each) for each in folders])
    names = ("no-op, 40 cycles", "own-navigation-exit-level, 40 cycles")
    assert table.header[2:] == names
    by_measure = {line[1]: line[2:] for line in table.rows}
    assert by_measure["transmissions direct to a fix"][1] == "100.0 %"
    assert by_measure["elements per transmission"][0] == NOTHING
    assert main([*map(str, folders)]) == 0
    assert capsys.readouterr().out.count("\n") == len(table.rows) + 2
    assert main([str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_stored_results_have_a_table_for_each_simulator(tmp_path, capsys, monkeypatch):
    results = [
        result(agent, traffic, platform)
        for agent in ("search", "rules")
        for platform in ("skystack", "bluebird")
        for traffic in ("category", "notebook")
    ]
    monkeypatch.setattr(training_objectives, "RESULTS", tmp_path / "results.jsonl")
    write_results(training_objectives.RESULTS, results)

    def named(found):
        rows = [each.hour_row for each in found]
        return Table(tuple(f"{row.agent} {row.platform}" for row in rows), ())

    monkeypatch.setattr(training_objectives, "table_of", named)
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("| ")] == [
        "| search skystack | rules skystack |",
        "| search bluebird | rules bluebird |",
    ]
