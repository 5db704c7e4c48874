"""Other processors: which scenarios count as identical, and the results on an older one."""

import platform

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.policies.measured import read_measured
from skystack.policies.shipped import SHIPPED
from tests.docs.blocks import ROOT
from verification.robustness import other_processors
from verification.robustness.other_processors import (
    LEAST_SAME,
    MAX_APART_NM,
    PROCESSORS,
    Likeness,
    deviations_from_record,
    flown,
    likeness,
)


def write_tables(folder, cycle=3, success=True, separation_nm=7.0, lat=0.5):
    """Tables of two scenarios of one aircraft; the arguments describe the second."""
    folder.mkdir()
    episodes = {
        "scenario": [0, 1],
        "clearances": [1, 1],
        "success": [True, success],
        "min_separation_nm": [9.0, separation_nm],
    }
    clearances = {
        "scenario": [0, 1],
        "cycle": [2, cycle],
        "callsign": ["AC1", "AC1"],
        "kind": ["heading", "heading"],
        "value": [90, 270],
    }
    trajectories = {"scenario": [0, 0, 1, 1], "lat": [0.0, 0.1, 0.0, lat], "lon": [0.0] * 4}
    tables = {"episodes": episodes, "clearances": clearances, "trajectories": trajectories}
    for name, columns in tables.items():
        pq.write_table(pa.table(columns), folder / f"{name}.parquet")
    return folder


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ({}, Likeness(2, 2, 0.0)),
        ({"separation_nm": 7.001}, Likeness(2, 2, 0.0)),
        ({"cycle": 4, "lat": 9.0}, Likeness(1, 2, 0.0)),
        ({"success": False}, Likeness(1, 2, 0.0)),
        ({"lat": 0.75}, Likeness(2, 2, 15.0)),
    ],
)
def test_compares_clearances_counts_and_positions(tmp_path, other, expected):
    ours = write_tables(tmp_path / "ours")
    assert likeness(ours, write_tables(tmp_path / "theirs", **other)) == expected


def test_promises_match_the_documentation():
    assert Likeness(990, 1000, 0.01).holds
    assert not Likeness(989, 1000, 0.0).holds
    assert not Likeness(1000, 1000, 0.011).holds
    page = (ROOT / "docs" / "reliability.md").read_text()
    assert f"at least {LEAST_SAME:.0%} of the scenarios".replace("%", " %") in page
    assert f"no aircraft is more than {MAX_APART_NM} NM" in page


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="imitates processors of x86-64")
def test_older_processor_reproduces_the_recorded_results(tmp_path, monkeypatch):
    """The recorded results are from another machine, with newer instructions."""
    tables = flown("vertical", 1000, tmp_path, PROCESSORS["SSE4.2"])
    assert deviations_from_record("vertical", tables) == []
    measured = read_measured(SHIPPED / "vertical")
    rows = [row | {"instructions_mean": row["instructions_mean"] * 1.02} for row in measured.rows]
    other = msgspec.structs.replace(measured, rows=rows)
    monkeypatch.setattr(other_processors, "read_measured", lambda folder: other)
    (line,) = deviations_from_record("vertical", tables)
    assert line.startswith("instructions_mean is ")
