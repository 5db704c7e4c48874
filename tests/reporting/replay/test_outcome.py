"""The reasons for failures, from the criteria in the tables and the flights."""

import pyarrow.parquet as pq
import pytest

from skystack.evaluation.writing import write_table
from skystack.reporting.replay.outcome import Failure, Flown, counts_clearances, failures_of
from skystack.reporting.replay.page import FORMAT, page_data
from skystack.reporting.replay.recording import read_replay

FLYING = Flown(("before_entry", "in_sector"), 300.0, 300, 2)
EXITED = Flown(("in_sector", "exited"), 300.0, 300, 29)
TOO_LOW = Flown(("in_sector", "exited"), 299.9998, 300, 30)
OUTSIDE = Flown(("in_sector", "excursion", "exited"), 300.0, 300, 0)
SUCCEEDED = {"success": True, "correct_exit": True, "excursion": False, "few_clearances": True}


@pytest.mark.parametrize(
    ("aircraft", "criteria", "expected"),
    [
        ((EXITED,), {}, ()),
        ((EXITED, OUTSIDE), {"excursion": True}, (Failure("excursion", (1,)),)),
        ((FLYING, EXITED), {"correct_exit": False}, (Failure("not_exited", (0,)),)),
        # A tick, 1/6000 FL, is enough, as in the tasks.
        ((EXITED, TOO_LOW), {"correct_exit": False}, (Failure("wrong_exit_level", (1,)),)),
        ((EXITED, TOO_LOW), {"few_clearances": False}, (Failure("too_many_clearances", (1,)),)),
        (
            (OUTSIDE, TOO_LOW, FLYING),
            {"excursion": True, "correct_exit": False, "few_clearances": False},
            (
                Failure("excursion", (0,)),
                Failure("wrong_exit_level", (1,)),
                Failure("not_exited", (2,)),
                Failure("too_many_clearances", (1,)),
            ),
        ),
    ],
)
def test_reasons_name_the_aircraft(aircraft, criteria, expected):
    episode = SUCCEEDED | {"success": not criteria} | criteria
    assert failures_of(episode, aircraft, True) == expected


def test_no_reason_without_criteria_in_the_table():
    assert failures_of({"success": False}, (FLYING,), True) == ()


def test_many_clearances_are_no_reason_if_they_are_no_criterion():
    """A success with many clearances shows that they are none."""
    many = SUCCEEDED | {"few_clearances": False}
    assert counts_clearances([SUCCEEDED, many | {"success": False}])
    assert not counts_clearances([SUCCEEDED, many])
    failed = many | {"success": False, "correct_exit": False}
    assert failures_of(failed, (FLYING, TOO_LOW), False) == (
        Failure("wrong_exit_level", (1,)),
        Failure("not_exited", (0,)),
    )


def test_every_failed_scenario_of_an_evaluation_has_a_reason(evaluation):
    episodes = pq.read_table(evaluation / "episodes.parquet").to_pylist()
    for scenario, episode in zip(read_replay(evaluation).scenarios, episodes, strict=True):
        assert bool(scenario.failures) == (not episode["success"])
        reasons = {each.reason for each in scenario.failures}
        assert ("excursion" in reasons) == (episode["excursion"] and not episode["success"])
        for each in scenario.failures:
            assert each.aircraft


def test_exit_offsets_are_those_of_the_table(evaluation, tmp_path):
    """Tables of older versions have no exit offsets and no criteria."""
    rows = pq.read_table(evaluation / "aircraft.parquet").to_pylist()
    replay = read_replay(evaluation)
    aircraft = [each for scenario in replay.scenarios for each in scenario.aircraft]
    assert [each.exit_offset_nm for each in aircraft] == [row["exit_offset_nm"] for row in rows]
    assert any(each.exit_offset_nm is not None for each in aircraft)
    for name in ("episodes", "aircraft", "trajectories", "clearances"):
        table = pq.read_table(evaluation / f"{name}.parquet")
        older = {"exit_offset_nm", "correct_exit"} & set(table.column_names)
        write_table(
            tmp_path / f"{name}.parquet", table.drop_columns(sorted(older)), replay.sector, "table"
        )
    old = read_replay(tmp_path)
    assert {each.exit_offset_nm for s in old.scenarios for each in s.aircraft} == {None}
    assert {s.failures for s in old.scenarios} == {()}


def test_page_data_has_reasons_and_offsets(evaluation):
    replay = read_replay(evaluation)
    data = page_data((replay,))
    assert data["format"] == FORMAT
    for packed, scenario in zip(data["runs"][0]["scenarios"], replay.scenarios, strict=True):
        assert [tuple(each.values()) for each in packed["failures"]] == list(scenario.failures)
        offsets = [each["exit_offset_nm"] for each in packed["aircraft"]]
        assert offsets == [each.exit_offset_nm for each in scenario.aircraft]
