"""Results that are kept in the repository, and the shares of transmissions in made-up hours."""

import msgspec
import pyarrow as pa
import pytest

from skystack.errors import InputError
from studies.hour_results import (
    AIRCRAFT_COLUMNS,
    Result,
    Spoken,
    late_entries,
    read_results,
    spoken,
    write_results,
)
from tests.reporting.rows import hour_row


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


def test_late_entries_are_those_after_half_of_the_time():
    """Outside for 1 of 10 cycles, 5 of 10, 6 of 10, and 9 of 10."""
    rows = [(3, 4, 13), (0, 5, 10), (2, 8, 12), (0, 9, 10)]
    table = pa.Table.from_pylist([dict(zip(AIRCRAFT_COLUMNS, row, strict=True)) for row in rows])
    assert late_entries(table) == 0.5
    assert late_entries(table.slice(4)) is None


def test_nothing_was_transmitted():
    assert spoken(clearances((0, 0, 0, "AC1", "level")).slice(0, 0)) is None


def result(agent, traffic, platform, **changed):
    row = hour_row(agent, traffic, platform=platform, losses_per_flight_hour=0.5, **changed)
    return Result("2026-11-29", msgspec.to_builtins(row), Spoken(0.1, 0.2, 0.3, 0.4, 0.5))


def test_reads_what_was_written(tmp_path):
    path = tmp_path / "new" / "results.jsonl"
    assert read_results(path) == []
    results = [result("search", "category", "skystack"), result("rules", "60", "bluebird")]
    write_results(path, results)
    assert read_results(path) == results
    assert read_results(path)[1].hour_row.platform == "bluebird"


def test_a_damaged_line_is_named(tmp_path):
    path = tmp_path / "results.jsonl"
    write_results(path, [result("search", "category", "skystack")] * 2)
    with pytest.raises(InputError, match="line 2: search, category, skystack is already in line 1"):
        read_results(path)
    text = path.read_text()
    path.write_text(text.replace('"spoken"', '"x"'))
    with pytest.raises(InputError, match=r"results\.jsonl: line 1: damaged"):
        read_results(path)
    path.write_text(text.replace('"flights":1234', '"flights":-1'))
    with pytest.raises(InputError, match=r"results\.jsonl: line 1: .*flights"):
        read_results(path)
