"""Tables from strangers: a few bytes may say that they are gigabytes."""

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.airspace.sector_file import SectorEntry, make_sector
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation import columns, stored, writing
from skystack.evaluation.stored import read_table, rows_of, sector_of
from skystack.evaluation.writing import write_table


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
    with pytest.raises(InputError, match=r"is too large: 100 rows to .*, \d+ bytes in a row group"):
        read_table(path, ("cycle",))


@pytest.fixture
def many(tmp_path, monkeypatch):
    """A table of scenarios 0 to 99, 7 rows each, in row groups of 10 rows."""
    monkeypatch.setattr(writing, "GROUP_ROWS", 10)
    path = tmp_path / "many.parquet"
    rows = range(700)
    table = pa.table({"scenario": [row // 7 for row in rows], "cycle": [row % 7 for row in rows]})
    write_table(path, table, x_plus(), "table")
    return path


@pytest.mark.parametrize(
    "numbers", [[0], [42], [99], [3, 4], [0, 50, 99], [100], [], list(range(100))]
)
def test_only_row_groups_that_hold_what_is_asked_for_are_read(numbers, many):
    """And of them all, by brute force over the rows of each group."""
    file = pq.ParquetFile(many)
    groups = range(file.num_row_groups)
    held = [set(file.read_row_group(each)["scenario"].to_pylist()) for each in groups]
    expected = [each for each in groups if held[each] & set(numbers)]
    ways = [[("scenario", "in", numbers)]]
    ways += [[("cycle", "=", 2), ("scenario", "=", number)] for number in numbers[:1]]
    for way in ways[: len(numbers) + 1] if len(numbers) < 2 else ways[:1]:
        assert stored._groups(many, file.metadata, way) == expected
    assert len(expected) <= 2 * len(numbers)
    table = read_table(many, ("scenario", "cycle"), ways[0])
    assert table["scenario"].to_pylist() == [n for n in numbers if n < 100 for _ in range(7)]


def test_the_greatest_number_of_rows_is_of_what_may_be_asked_for(many, monkeypatch):
    monkeypatch.setattr(stored, "MOST_ROWS", 20)
    assert read_table(many, ("cycle",), [("scenario", "=", 60)]).num_rows == 7
    with pytest.raises(InputError, match=r"is too large: 700 rows to .* 20 rows"):
        read_table(many, ("cycle",))


@pytest.mark.parametrize("index", ["[]", "[[0, 5]]", "[[0, -1]]", "[[0, 1e99]]", "{", '"x"'])
def test_an_index_of_another_table_is_damage(index, tmp_path):
    path = tmp_path / "table.parquet"
    table = pa.table({"scenario": [0, 1, 2, 3]}).replace_schema_metadata({"scenarios": index})
    pq.write_table(table, path, row_group_size=2)
    with pytest.raises(InputError, match=r"table.parquet: (damaged|the scenarios in its metadata)"):
        read_table(path, ("scenario",), [("scenario", "=", 3)])


def test_a_table_without_an_index_is_read_as_a_whole(tmp_path):
    path = tmp_path / "table.parquet"
    pq.write_table(pa.table({"scenario": [3, 1, 2, 3]}), path, row_group_size=2)
    assert read_table(path, ("scenario",), [("scenario", "=", 3)]).num_rows == 2


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
