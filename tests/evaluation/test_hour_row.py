"""Rows of hours in files, which may be damaged."""

import json

import msgspec
import pytest

from skystack.errors import InputError
from skystack.evaluation.hour_row import ROW_FILE, folders_of_hours, read_row, write_row
from tests.reporting.rows import hour_row


def test_a_row_is_read_as_it_was_written(tmp_path):
    row = hour_row("search", "60", safety_net=False, correct_exit_rate=None)
    write_row(tmp_path, msgspec.to_builtins(row) | {"more": [1, 2]})
    assert read_row(tmp_path) == row
    assert (row.flights_per_hour, row.length_s) == (60.0, 3600.0)
    assert hour_row("search", "category").flights_per_hour is None


def test_folders_of_hours_are_found(tmp_path):
    assert folders_of_hours(tmp_path) == []
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        write_row(tmp_path / name, {})
    assert folders_of_hours(tmp_path) == [tmp_path / "a", tmp_path / "b"]
    assert folders_of_hours(tmp_path / "a") == [tmp_path / "a"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"flights": -1}, "flights"),
        ({"correct_exit_rate": 1.5}, "correct_exit_rate"),
        ({"agent": ""}, "agent"),
        ({"lax_s_by_hour": ["soon"]}, "lax_s_by_hour"),
        ({"hours": 1e300}, "hours"),
        ({"hours": 0}, "hours"),
        ({"lax_s_by_hour": []}, "lax_s_by_hour"),
        ({"traffic": "1e308"}, "traffic"),
        ({"traffic": "nan"}, "traffic"),
        ({"traffic": "<b>"}, "traffic"),
    ],
)
def test_damaged_rows_are_refused(tmp_path, change, message):
    path = tmp_path / ROW_FILE
    path.write_text(json.dumps(msgspec.to_builtins(hour_row("search", "60")) | change))
    with pytest.raises(InputError) as raised:
        read_row(tmp_path)
    assert str(raised.value).startswith(str(path))
    assert message in str(raised.value)
    path.write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        read_row(tmp_path)
