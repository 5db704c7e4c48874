"""Two evaluations have the same clearances: order, aircraft, values and nearly the cycle."""

import pyarrow as pa
import pytest

from skystack.evaluation.agreement import same_clearances

ISSUED = [(0, 5, "AC1", "heading", 35), (0, 9, "AC2", "heading", 125), (2, 7, "AC1", "level", 340)]


def table(rows):
    names = ("scenario", "cycle", "callsign", "kind", "value")
    return pa.table({name: [row[i] for row in rows] for i, name in enumerate(names)})


def with_row_changed(row, **fields):
    names = ("scenario", "cycle", "callsign", "kind", "value")
    return [
        tuple((dict(zip(names, entry, strict=True)) | fields).values()) if i == row else entry
        for i, entry in enumerate(ISSUED)
    ]


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (ISSUED, [True, True, True]),
        (with_row_changed(0, cycle=6), [True, True, True]),
        (with_row_changed(0, cycle=7), [False, True, True]),
        (with_row_changed(0, value=36), [False, True, True]),
        (with_row_changed(1, callsign="AC1"), [False, True, True]),
        (with_row_changed(2, kind="heading"), [True, True, False]),
        (ISSUED[:2], [True, True, False]),
        ([ISSUED[1], ISSUED[0], ISSUED[2]], [False, True, True]),
        ([*ISSUED, (1, 3, "AC1", "heading", 10)], [True, False, True]),
    ],
)
def test_same_clearances(other, same):
    assert same_clearances(table(ISSUED), table(other), range(3)) == same
