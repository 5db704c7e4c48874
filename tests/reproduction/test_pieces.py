"""A piece of work is done once for what it is made from, and again when anything is amiss."""

import json

import pytest

from skystack.reproduction.pieces import once


class Maker:
    """Writes a file, counts how often."""

    def __init__(self, folder):
        self.path, self.times = folder / "made", 0

    def __call__(self):
        self.times += 1
        self.path.write_text(f"number {self.times}")
        return {"number": self.times}


@pytest.fixture
def maker(tmp_path):
    return Maker(tmp_path)


def test_a_finished_piece_is_not_made_again(maker, tmp_path):
    record = tmp_path / "record.json"
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 1}, False)
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 1}, True)
    assert maker.times == 1


@pytest.mark.parametrize(
    "spoil",
    [
        lambda maker, record: maker.path.write_text("something else"),
        lambda maker, record: maker.path.unlink(),
        lambda maker, record: record.write_text("{"),
        lambda maker, record: record.write_text("[]"),
        lambda maker, record: record.write_text('{"key": {"a": 1}, "result": 5}'),
        lambda maker, record: record.unlink(),
    ],
)
def test_a_damaged_piece_is_made_again(maker, tmp_path, spoil):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])
    spoil(maker, record)
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, False)
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, True)


def test_a_piece_made_from_something_else_is_made_again(maker, tmp_path):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])
    assert once(record, {"a": 2}, maker, ["made"]) == ({"number": 2}, False)


@pytest.mark.parametrize("files", [{}, {"../made": "0"}, {"/dev/zero": "0"}, {"made": 3}])
def test_a_record_does_not_decide_which_files_are_read(maker, tmp_path, files):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])
    kept = json.loads(record.read_text())
    kept["files"] |= files
    record.write_text(json.dumps(kept if files else kept | {"files": {}}))
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, False)


def test_a_piece_that_failed_half_way_leaves_no_record(maker, tmp_path):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])

    def fail():
        maker.path.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        once(record, {"a": 2}, fail, ["made"])
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, False)
