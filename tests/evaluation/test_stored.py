"""Stored tables: untrusted files, where a few bytes may claim gigabytes, and flown scenarios."""

import os

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.airspace.sector_file import SectorEntry, make_sector
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation import columns, stored, writing
from skystack.evaluation.stored import (
    MAX_STORED_CYCLES,
    check_aircraft,
    has_column,
    metadata_of,
    read_table,
    rows_of,
    sector_of,
    stored_scenario,
)
from skystack.evaluation.tables import make_tables
from skystack.evaluation.tabulate import TABLES
from skystack.evaluation.writing import growing_tables, table_metadata, write_table
from skystack.platforms.registry import flown_type
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.scenario_file import Aircraft, ScheduledClearance
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

from .recordings import recording


def repeated(text, rows):
    """A dictionary-encoded column of one text, which the file contains once."""
    return pa.DictionaryArray.from_arrays(pa.array([0] * rows, pa.int32()), [text])


def write_columns(folder, **columns):
    path = folder / "table.parquet"
    pq.write_table(pa.table(columns), path, store_schema=False)
    return path


def test_rejects_a_huge_repeated_text_before_decoding(tmp_path):
    path = write_columns(tmp_path, text=repeated("x" * 100_000, 200_000))  # 20 GB
    assert path.stat().st_size < 10_000
    with pytest.raises(InputError, match=r"'text' holds too much text \(allowed: 100000000 bytes"):
        read_table(path, ("text",))


@pytest.mark.parametrize("rows", [columns.MAX_KEPT_ROWS, columns.MAX_KEPT_ROWS + 1])
def test_limits_the_rows_that_are_read_at_once(rows, tmp_path):
    path = write_columns(tmp_path, cycle=pa.array([1]).take(pa.array([0] * rows)))
    if rows == columns.MAX_KEPT_ROWS:
        assert read_table(path, ("cycle",)).num_rows == rows
        return
    with pytest.raises(InputError, match=r"too large to be read at once \(allowed: 1000000 rows"):
        read_table(path, ("cycle",))


def test_reads_requested_rows_of_a_large_table(tmp_path):
    rows = columns.MAX_KEPT_ROWS + 10
    numbers = pa.array(range(rows))
    path = write_columns(tmp_path, scenario=numbers, cycle=numbers)
    found = read_table(path, ("cycle",), [("scenario", "in", [3, rows - 1])])
    assert found["cycle"].to_pylist() == [3, rows - 1]


def test_rejects_too_many_bytes_by_the_metadata(tmp_path, monkeypatch):
    path = write_columns(tmp_path, cycle=range(100))
    assert read_table(path, ("cycle",)).num_rows == 100
    monkeypatch.setattr(stored, "MAX_GROUP_BYTES", 800)
    with pytest.raises(InputError, match=r"is too large: 100 rows to .*, \d+ bytes in a row group"):
        read_table(path, ("cycle",))


@pytest.fixture
def table_path(tmp_path, monkeypatch):
    """A table of scenarios 0 to 99 with 7 rows each, in row groups of 10 rows."""
    monkeypatch.setattr(writing, "GROUP_ROWS", 10)
    path = tmp_path / "many.parquet"
    rows = range(700)
    table = pa.table({"scenario": [row // 7 for row in rows], "cycle": [row % 7 for row in rows]})
    write_table(path, table, x_plus(), "table")
    return path


@pytest.mark.parametrize(
    "numbers", [[0], [42], [99], [3, 4], [0, 50, 99], [100], [], list(range(100))]
)
def test_only_row_groups_with_requested_scenarios_are_read(numbers, table_path):
    """And all of them, by brute force over the rows of each group."""
    file = pq.ParquetFile(table_path)
    groups = range(file.num_row_groups)
    contents = [set(file.read_row_group(each)["scenario"].to_pylist()) for each in groups]
    expected = [each for each in groups if contents[each] & set(numbers)]
    choices = [[("scenario", "in", numbers)]]
    choices += [[("cycle", "=", 2), ("scenario", "=", number)] for number in numbers[:1]]
    for filters in choices[: len(numbers) + 1] if len(numbers) < 2 else choices[:1]:
        assert stored._groups(table_path, file.metadata, filters) == expected
    assert len(expected) <= 2 * len(numbers)
    table = read_table(table_path, ("scenario", "cycle"), choices[0])
    assert table["scenario"].to_pylist() == [n for n in numbers if n < 100 for _ in range(7)]


def test_the_row_limit_counts_only_requested_scenarios(table_path, monkeypatch):
    monkeypatch.setattr(stored, "MAX_ROWS", 20)
    assert read_table(table_path, ("cycle",), [("scenario", "=", 60)]).num_rows == 7
    with pytest.raises(InputError, match=r"is too large: 700 rows to .* 20 rows"):
        read_table(table_path, ("cycle",))


@pytest.mark.parametrize("index", ["[]", "[[0, 5]]", "[[0, -1]]", "[[0, 1e99]]", "{", '"x"'])
def test_rejects_an_invalid_index_of_scenarios(index, tmp_path):
    path = tmp_path / "table.parquet"
    table = pa.table({"scenario": [0, 1, 2, 3]}).replace_schema_metadata({"scenarios": index})
    pq.write_table(table, path, row_group_size=2)
    with pytest.raises(InputError, match=r"table.parquet: (damaged|the scenarios in its metadata)"):
        read_table(path, ("scenario",), [("scenario", "=", 3)])


def test_reads_all_of_a_table_without_an_index(tmp_path):
    path = tmp_path / "table.parquet"
    pq.write_table(pa.table({"scenario": [3, 1, 2, 3]}), path, row_group_size=2)
    assert read_table(path, ("scenario",), [("scenario", "=", 3)]).num_rows == 2


@pytest.mark.parametrize("kind", [pa.float16(), pa.timestamp("s"), pa.bool_()])
def test_rejects_other_number_types_unless_empty(kind, tmp_path):
    path = write_columns(tmp_path, lat=pa.nulls(3, kind).fill_null(pa.scalar(0).cast(kind)))
    with pytest.raises(InputError, match=r"column 'lat' holds .* \(allowed: numbers\)"):
        read_table(path, ("lat",))
    assert read_table(write_columns(tmp_path, lat=pa.array([], kind)), ("lat",)).num_rows == 0


def test_selects_the_rows_of_one_aircraft(tmp_path):
    callsigns = pa.array(["AC1", "AC2", "AC1"]).dictionary_encode()
    table = read_table(
        write_columns(tmp_path, callsign=callsigns, cycle=[0, 0, 1]), ("callsign", "cycle")
    )
    assert rows_of("AC1", table)["cycle"].to_pylist() == [0, 1]


@pytest.mark.parametrize("encoded", [True, False])
def test_replaces_the_old_name_of_an_excursion(encoded, tmp_path):
    """In tables of older versions. All other values and the metadata stay unchanged."""
    status = pa.array(["in_sector", "strayed", "excursion", "exited"])
    path = tmp_path / "table.parquet"
    table = pa.table(
        {"cycle": range(4), "status": status.dictionary_encode() if encoded else status}
    )
    write_table(path, table, x_plus(), "table")
    found = read_table(path, ("cycle", "status"))
    assert found["status"].to_pylist() == ["in_sector", "excursion", "excursion", "exited"]
    assert found["cycle"].to_pylist() == [0, 1, 2, 3]
    assert sector_of(path, found) == x_plus()


@pytest.mark.parametrize(
    ("field", "point", "where", "limits"),
    [
        ("fixes", (1e300, 0.0), r"fixes\.EGL\.lat", "allowed: number from -"),
        ("origin", (0.0, 400.0), r"origin\.lon", "allowed: number from -360 to 360"),
    ],
)
def test_rejects_a_sector_with_impossible_coordinates(field, point, where, limits, tmp_path):
    sector = msgspec.to_builtins(x_plus())
    sector[field] = sector[field] | {"EGL": point} if field == "fixes" else point
    path = tmp_path / "table.parquet"
    table = pa.table({"cycle": [0]})
    pq.write_table(table.replace_schema_metadata({"sector": msgspec.json.encode(sector)}), path)
    message = f"the sector in its metadata: {where} is .*{limits}"
    with pytest.raises(InputError, match=message):
        sector_of(path, read_table(path, ("cycle",)))


@pytest.mark.parametrize("east", [0.0, 179.7])  # and across the antimeridian
def test_reads_back_the_sector_that_was_written(east, tmp_path):
    """Area, fixes, levels and separation standards."""
    entry = {
        "name": "three miles",
        "levels_fl": [200, 400],
        "separation_nm": 3.0,
        "separation_fl": 20,
        "area": {
            "type": "Polygon",
            "coordinates": [[[east, 59.0], [east + 1.0, 58.5], [east + 1.0, 60], [east, 60]]],
        },
        "fixes": {
            "W": {"lat": 59.5, "lon": east - 0.2},
            "E": {"lat": 59.5, "lon": east + 1.0},
            "O": {"lat": 59.5, "lon": east + 1.2},
        },
        "routes": [["W", "E", "O"]],
    }
    sector = make_sector(msgspec.convert(entry, SectorEntry))
    path = tmp_path / "table.parquet"
    write_table(path, pa.table({"cycle": [0]}), sector, "table")
    assert sector_of(path, read_table(path, ("cycle",))) == sector
    assert (sector.separation_nm, sector.separation_fl) == (3.0, 20)


def test_rejects_a_structure_in_a_text_column(tmp_path):
    path = write_columns(tmp_path, callsign=pa.array([{"inner": "AC1"}]))
    with pytest.raises(InputError, match="damaged: cannot be read as a Parquet table"):
        read_table(path, ("callsign",))


FLEET = (AircraftType(), AircraftType("AT76", mach=(0.4, 0.4, 0.4)))
TASK = build_task(NavigationSettings(fleet=FLEET, aircraft=2))


@pytest.fixture
def folder(tmp_path):
    """Tables of scenarios 4 and 9, flown by BlueSky. In 9, AC2 is turned in cycles 0 and 2."""
    flown = recording(
        [4, 9],
        np.ones((2, 3)),
        start={
            "route": [[1, 1], [3, 2]],
            "kind": [[0, 0], [1, 0]],
            "level_ticks": [[300.0, 300.0], [280.5, 310.0]],
            "heading_deg": [[1.0, 2.0], [12.5, 350.0]],
            "own_navigation": [[False, False], [True, False]],
        },
        later={"cleared_heading_deg": [[[0.0, 90.0]] * 3, [[0.0, 340.0], [0, 340], [0, 330]]]},
        exit_level_ticks=np.full((2, 2), 220.0 * TICKS_PER_FL, dtype=np.float32),
        action=np.array([[4, 0, 0], [3, 0, 3]], dtype=np.int32),
        instructions=np.array([[9, 0, 0], [1, 0, 1]], dtype=np.int32),
    )
    tables = make_tables(TASK, flown, lambda kind: flown_type("bluesky", kind))
    with growing_tables(tmp_path, TABLES, table_metadata(TASK.sector, "table", FLEET)) as append:
        append(vars(tables))
    return tmp_path


def test_reads_the_requested_scenario_as_it_was_flown(folder):
    """Scenario 9, not 4, with the requested aircraft types, not those that BlueSky substituted."""
    routes = TASK.sector.routes
    found = stored_scenario(folder, 9)
    assert found.aircraft == (
        Aircraft("AC1", "AT76", routes[3], 0.0, 0.0, 280.5, 12.5, 220, True),
        Aircraft("AC2", "B753", routes[2], 0.0, 0.0, 310.0, 350.0, 220, False),
    )
    assert found.clearances == (
        ScheduledClearance(0, "AC2", 340),
        ScheduledClearance(2, "AC2", 330),
    )
    assert (found.cycles, found.performance, found.fleet) == (3, "table", FLEET)
    assert found.sector == TASK.sector


def replace_values(folder, name, number=9, /, **values):
    """Replace columns in the rows of one scenario in one table."""
    path = folder / f"{name}.parquet"
    table = pq.read_table(path)
    rows = table.to_pylist()
    for row in rows:
        if row["scenario"] == number:
            row.update(values)
    changed = pa.Table.from_pylist(rows).replace_schema_metadata(table.schema.metadata)
    pq.write_table(changed, path)


@pytest.mark.parametrize(
    ("values", "row"),
    [
        ({"cycle": 3}, "3, AC2, heading, 340"),
        ({"value": 361}, "0, AC2, heading, 361"),
        ({"kind": "level", "value": 601}, "0, AC2, level, 601"),
        ({"kind": "speed"}, "0, AC2, speed, 340"),
        ({"callsign": "AC3"}, "0, AC3, heading, 340"),
    ],
)
def test_rejects_an_impossible_clearance(folder, values, row):
    replace_values(folder, "clearances", 4, cycle=77, value=999)  # not read
    replace_values(folder, "clearances", **values)
    with pytest.raises(InputError, match=f"clearances.parquet: not a clearance .*: {row}"):
        stored_scenario(folder, 9)


@pytest.mark.parametrize(
    ("values", "clearance"),
    [
        ({"cycle": 2, "value": 360}, ScheduledClearance(2, "AC2", 360)),
        ({"cycle": 0, "kind": "level", "value": 600}, ScheduledClearance(0, "AC2", fl=600)),
    ],
)
def test_accepts_the_last_cycle_and_the_greatest_values(folder, values, clearance):
    replace_values(folder, "clearances", **values)
    assert stored_scenario(folder, 9).clearances == (clearance, clearance)


@pytest.mark.parametrize("cycles", [0, 1, MAX_STORED_CYCLES, MAX_STORED_CYCLES + 1])
def test_limits_the_cycles_of_a_scenario(folder, cycles):
    replace_values(folder, "episodes", cycles=cycles)
    pq.write_table(pq.read_table(folder / "clearances.parquet")[:0], folder / "clearances.parquet")
    replace_values(folder, "episodes", clearances=0)
    if 1 <= cycles <= MAX_STORED_CYCLES:
        assert stored_scenario(folder, 9).cycles == cycles
        return
    with pytest.raises(InputError, match=f"scenario 9 has {cycles} cycles .1 to 100000"):
        stored_scenario(folder, 9)


def test_rejects_inconsistent_tables(folder):
    with pytest.raises(InputError, match="has no scenario 5"):
        stored_scenario(folder, 5)
    replace_values(folder, "episodes", 4, scenario=9)
    with pytest.raises(InputError, match="its tables do not agree on scenario 9"):
        stored_scenario(folder, 9)
    replace_values(folder, "episodes", clearances=1)  # clearances.parquet has two
    with pytest.raises(InputError, match="its tables do not agree on scenario 9"):
        stored_scenario(folder, 9)
    replace_values(folder, "episodes", scenario=4)
    with pytest.raises(InputError, match="do not agree"):
        stored_scenario(folder, 9)


def test_rejects_aircraft_that_differ_from_the_trajectories(folder):
    replace_values(folder, "aircraft", callsign="AC1")
    with pytest.raises(InputError, match="its tables do not agree on scenario 9"):
        stored_scenario(folder, 9)


def test_names_a_missing_table(folder):
    (folder / "aircraft.parquet").unlink()
    with pytest.raises(InputError, match=r"aircraft\.parquet: missing \(evaluation writes it\)"):
        stored_scenario(folder, 9)


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"performance": b"fast"}, "unknown performance 'fast' in its metadata"),
        (
            {"fleet": b"[{}, {}]"},
            r"its metadata: fleet\[1\].type is B753 .allowed: every",
        ),
        ({"fleet": b"[3]"}, "the fleet in its metadata: "),
        ({"sector": None}, "has no sector in its metadata"),
    ],
)
def test_rejects_invalid_metadata(folder, metadata, message):
    path = folder / "trajectories.parquet"
    table = pq.read_table(path)
    known = {key.decode(): value for key, value in table.schema.metadata.items()} | metadata
    known = {key: value for key, value in known.items() if value is not None}
    pq.write_table(table.replace_schema_metadata(known), path)
    with pytest.raises(InputError, match=rf"trajectories\.parquet: {message}"):
        stored_scenario(folder, 9)


def test_performance_and_fleet_have_defaults(folder):
    path = folder / "trajectories.parquet"
    table = pq.read_table(path)
    only = {"sector": table.schema.metadata[b"sector"]}
    pq.write_table(table.replace_schema_metadata(only), path)
    found = stored_scenario(folder, 4)
    assert (found.performance, found.fleet) == ("table", ())
    assert [one.type for one in found.aircraft] == ["B753", "B753"]


def aircraft_rows(*callsigns, route="HERON CRANE"):
    return [{"callsign": callsign, "route": route} for callsign in callsigns]


def test_checks_number_callsigns_and_routes_of_aircraft(tmp_path):
    path, sector = tmp_path / "aircraft.parquet", x_plus()
    check_aircraft(path, sector, aircraft_rows(*(f"A{number}" for number in range(200))))
    with pytest.raises(InputError, match=r"aircraft.parquet: has 201 aircraft .allowed: 200"):
        check_aircraft(path, sector, aircraft_rows(*(f"A{number}" for number in range(201))))
    with pytest.raises(InputError, match="parquet: A2 appears twice in one scenario"):
        check_aircraft(path, sector, aircraft_rows("A1", "A2", "A2"))
    with pytest.raises(InputError, match="the route of A1 has an unknown fix 'CRAN'"):
        check_aircraft(path, sector, aircraft_rows("A1", route="HERON CRAN"))


def test_reads_embedded_tables_from_the_metadata(tmp_path):
    path = tmp_path / "table.parquet"
    one = {"callsign": "AC1", "type": "B753", "route": "A B", "entry_fl": 300.5, "exit_fl": 220}
    write_table(path, pa.table({"cycle": [0]}), x_plus(), "table", embedded={"aircraft": [one]})
    table = read_table(path, ("cycle",))
    assert metadata_of(path, table, "aircraft") == [one]
    with pytest.raises(InputError, match=r"has no clearances in its metadata .simulate writes"):
        metadata_of(path, table, "clearances")
    assert (has_column(path, "cycle"), has_column(path, "lat")) == (True, False)
    path.write_bytes(path.read_bytes().replace(b"cycle", b"cycl\xff"))
    with pytest.raises(InputError, match="missing or damaged"):
        has_column(path, "cycle")
    with pytest.raises(InputError, match=r"absent.parquet: missing or damaged"):
        has_column(tmp_path / "absent.parquet", "cycle")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["cycle"], r"has no column 'lat' \(found: cycle\)"),
        (["lat", "cycle", "lat"], r"has 'lat' twice \(found: lat, cycle, lat\)"),
    ],
)
def test_each_column_must_appear_exactly_once(tmp_path, names, message):
    path = tmp_path / "table.parquet"
    pq.write_table(pa.table([[1.0]] * len(names), names=names), path)
    with pytest.raises(InputError, match=message):
        read_table(path, ("lat",))


def test_limits_the_rows_of_a_filtered_table(tmp_path, monkeypatch):
    path = write_columns(tmp_path, cycle=range(100))
    monkeypatch.setattr(stored, "MAX_ROWS", 100)
    assert read_table(path, ("cycle",), [("cycle", "=", 7)])["cycle"].to_pylist() == [7]
    monkeypatch.setattr(stored, "MAX_ROWS", 99)
    with pytest.raises(InputError, match=r"100 rows.*allowed: 99 rows"):
        read_table(path, ("cycle",), [("cycle", "=", 7)])


def test_limits_the_bytes_of_a_row_group(tmp_path, monkeypatch):
    path = write_columns(tmp_path, cycle=range(100))
    size = pq.read_metadata(path).row_group(0).total_byte_size
    monkeypatch.setattr(stored, "MAX_GROUP_BYTES", size)
    assert read_table(path, ("cycle",)).num_rows == 100
    monkeypatch.setattr(stored, "MAX_GROUP_BYTES", size - 1)
    with pytest.raises(InputError, match=f"{size} bytes in a row group"):
        read_table(path, ("cycle",))


def test_reads_a_table_without_row_groups(tmp_path):
    path = tmp_path / "table.parquet"
    pq.ParquetWriter(path, pa.schema({"cycle": pa.int32()})).close()
    assert pq.read_metadata(path).num_row_groups == 0
    assert read_table(path, ("cycle",)).num_rows == 0


def test_reads_from_a_folder_whose_name_is_not_utf_8(tmp_path):
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    write_table(folder / "t.parquet", pa.table({"scenario": [1]}), x_plus(), "table")
    assert read_table(folder / "t.parquet", ("scenario",)).to_pylist() == [{"scenario": 1}]
    assert stored.has_column(folder / "t.parquet", "scenario")
    with pytest.raises(InputError, match=r"\\udcff/none.parquet: missing"):
        read_table(folder / "none.parquet", ("scenario",))
