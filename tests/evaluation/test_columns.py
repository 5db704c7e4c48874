"""The allowed types and values of each column in untrusted tables."""

import numpy as np
import pyarrow as pa
import pytest

from skystack.errors import InputError
from skystack.evaluation import columns
from skystack.evaluation.columns import check_columns

TEXT = ["callsign", "type", "route", "status", "kind", "direction", "text"]
BOOLEAN = [
    *("success", "correct_exit", "excursion", "few_clearances", "loss_of_separation"),
    "own_navigation",
]
WHOLE = [
    *("scenario", "cycle", "cycles", "time_s", "clearances", "instructions", "transmission"),
    *("value", "exit_fl"),
]
NUMBER = [
    *("lat", "lon", "fl", "entry_fl", "heading_deg", "cleared_heading_deg", "cleared_fl"),
    *("ground_speed_kt", "vertical_speed_ft_min", "return", "min_separation_nm"),
]
KINDS = {
    "text": (TEXT, pa.array(["a", "b"])),
    "true or false": (BOOLEAN, pa.array([True, False])),
    "whole numbers": (WHOLE, pa.array([0, 1], pa.int32())),
    "numbers": (NUMBER, pa.array([0.5, -1.5])),
}
COLUMNS = [(name, kind) for kind, (names, _) in KINDS.items() for name in names]


def check(name, values, kind=None):
    check_columns(pa.table({name: pa.array(values, kind) if isinstance(values, list) else values}))


def assert_rejected(name, values, message, kind=None):
    with pytest.raises(InputError, match=message):
        check(name, values, kind)


@pytest.mark.parametrize(("name", "kind"), COLUMNS)
def test_each_column_accepts_only_its_kind(name, kind):
    for other, (_, values) in KINDS.items():
        if other == kind or (kind, other) == ("numbers", "whole numbers"):
            check(name, values)
        else:
            assert_rejected(name, values, rf"column '{name}' holds \w+ \(allowed: {kind}\)")
    check(name, pa.array([], pa.int8()))


@pytest.mark.parametrize(("name", "kind"), COLUMNS)
def test_only_the_direction_may_be_null(name, kind):
    values = pa.concat_arrays([KINDS[kind][1], pa.nulls(2, KINDS[kind][1].type)])
    if name == "direction":
        check(name, values)
    else:
        assert_rejected(name, values, f"column '{name}' is empty in 2 rows")


@pytest.mark.parametrize("name", WHOLE)
def test_whole_numbers_are_between_0_and_1e9(name):
    check(name, [0, 1_000_000_000])
    assert_rejected(name, [3, -1], f"column '{name}' contains .* range .*numbers from 0 to 1e.09")
    assert_rejected(name, [3, 1_000_000_001], "0 to 1e.09")


@pytest.mark.parametrize("name", NUMBER)
def test_numbers_are_limited_and_only_separation_is_infinite(name):
    most = {"lat": 89.9999, "lon": 360.0}.get(name, 1e9)
    check(name, [-most, most])
    check(name, [1.5], pa.float32())
    for wrong in (-1.1 * most, 1.1 * most, np.nan, -np.inf):
        assert_rejected(
            name,
            [0.0, wrong],
            f"column '{name}' contains .* numbers from -.* to {most:g}".replace("+", "."),
        )
    if name == "min_separation_nm":
        check(name, [np.inf, 3.0])
    else:
        assert_rejected(name, [np.inf, 3.0], f"column '{name}' contains a value out of range")


def test_a_repeated_text_counts_in_every_row(monkeypatch):
    """3 + 3 bytes in the first chunk, 4 + 1 in the second."""
    chunks = [pa.array(texts).dictionary_encode() for texts in (["AC1", "AC1"], ["AC10", "F"])]
    monkeypatch.setattr(columns, "MAX_TEXT_BYTES", 11)
    check("callsign", pa.chunked_array(chunks))
    monkeypatch.setattr(columns, "MAX_TEXT_BYTES", 10)
    message = r"column 'callsign' holds too much text \(allowed: 10 bytes\)"
    assert_rejected("callsign", pa.chunked_array(chunks), message)


def test_accepts_every_encoding_of_text():
    for kind in (pa.string(), pa.large_string(), pa.dictionary(pa.int32(), pa.string())):
        check("status", pa.array(["exited"]).cast(kind))
    assert_rejected("status", pa.array([1]).dictionary_encode(), "holds int64 .allowed: text")
