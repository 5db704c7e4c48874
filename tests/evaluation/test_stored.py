"""Tables from strangers: a few bytes may say that they are gigabytes."""

import os

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.airspace.sector_file import SectorEntry, make_sector
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation import columns, stored
from skystack.evaluation.stored import read_table, rows_of, sector_of, write_table


def repeated(text, rows):
    """A column of one text, written as a dictionary: the file holds the text once."""
    return pa.DictionaryArray.from_arrays(pa.array([0] * rows, pa.int32()), [text])


def written(folder, **columns):
    path = folder / "table.parquet"
    pq.write_table(pa.table(columns), path, store_schema=False)
    return path


def test_a_text_that_stands_in_every_row_is_refused_before_it_is_unpacked(tmp_path):
    path = written(tmp_path, text=repeated("x" * 100_000, 200_000))  # 20 GB
    assert path.stat().st_size < 10_000
    with pytest.raises(InputError, match=r"'text' holds too much text \(allowed: 100000000 bytes"):
        read_table(path, ("text",))


@pytest.mark.parametrize("rows", [columns.MOST_KEPT_ROWS, columns.MOST_KEPT_ROWS + 1])
def test_more_rows_than_are_read_at_once_are_refused(rows, tmp_path):
    path = written(tmp_path, cycle=pa.array([1]).take(pa.array([0] * rows)))
    if rows == columns.MOST_KEPT_ROWS:
        assert read_table(path, ("cycle",)).num_rows == rows
        return
    with pytest.raises(InputError, match="too large to be read at once"):
        read_table(path, ("cycle",))


def test_of_a_large_table_what_is_asked_for_is_read(tmp_path):
    rows = columns.MOST_KEPT_ROWS + 10
    numbers = pa.array(range(rows))
    path = written(tmp_path, scenario=numbers, cycle=numbers)
    found = read_table(path, ("cycle",), [("scenario", "in", [3, rows - 1])])
    assert found["cycle"].to_pylist() == [3, rows - 1]


def test_more_bytes_than_allowed_are_refused_by_the_head(tmp_path, monkeypatch):
    path = written(tmp_path, cycle=range(100))
    assert read_table(path, ("cycle",)).num_rows == 100
    monkeypatch.setattr(stored, "MOST_GROUP_BYTES", 800)
    with pytest.raises(InputError, match=r"is too large: 100 rows, \d+ bytes in a row group"):
        read_table(path, ("cycle",))


@pytest.mark.parametrize("kind", [pa.float16(), pa.timestamp("s"), pa.bool_()])
def test_other_kinds_of_numbers_are_refused_where_there_are_any(kind, tmp_path):
    path = written(tmp_path, lat=pa.nulls(3, kind).fill_null(pa.scalar(0).cast(kind)))
    with pytest.raises(InputError, match=r"column 'lat' holds .* \(allowed: numbers\)"):
        read_table(path, ("lat",))
    assert read_table(written(tmp_path, lat=pa.array([], kind)), ("lat",)).num_rows == 0


def test_one_aircrafts_rows(tmp_path):
    signs = pa.array(["AC1", "AC2", "AC1"]).dictionary_encode()
    table = read_table(written(tmp_path, callsign=signs, cycle=[0, 0, 1]), ("callsign", "cycle"))
    assert rows_of("AC1", table)["cycle"].to_pylist() == [0, 1]


@pytest.mark.parametrize(("field", "at"), [("fixes", (1e300, 0.0)), ("origin", (0.0, 400.0))])
def test_a_sector_in_metadata_lies_on_the_earth(field, at, tmp_path):
    sector = msgspec.to_builtins(x_plus())
    sector[field] = sector[field] | {"EGL": at} if field == "fixes" else at
    path = tmp_path / "table.parquet"
    table = pa.table({"cycle": [0]})
    pq.write_table(table.replace_schema_metadata({"sector": msgspec.json.encode(sector)}), path)
    with pytest.raises(InputError, match=f"the sector in its metadata: {field}.*Expected `float`"):
        sector_of(path, read_table(path, ("cycle",)))


@pytest.mark.parametrize("east", [0.0, 179.7])  # there, on both sides of the antimeridian
def test_a_sector_in_metadata_is_the_one_that_was_flown_in(east, tmp_path):
    """Written as of an evaluation and read back: area, fixes, levels and separation standards."""
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


def test_a_text_that_is_a_structure_is_refused(tmp_path):
    path = written(tmp_path, callsign=pa.array([{"inner": "AC1"}]))
    with pytest.raises(InputError, match="damaged: cannot be read as a Parquet table"):
        read_table(path, ("callsign",))


def test_a_folder_whose_name_is_no_utf_8(tmp_path):
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    write_table(folder / "t.parquet", pa.table({"scenario": [1]}), x_plus(), "table")
    assert read_table(folder / "t.parquet", ("scenario",)).to_pylist() == [{"scenario": 1}]
    assert stored.has_column(folder / "t.parquet", "scenario")
    with pytest.raises(InputError, match=r"\\udcff/none.parquet: missing"):
        read_table(folder / "none.parquet", ("scenario",))
