"""A piece of work is done once per key, and repeated if its files or record are damaged."""

import json

import pytest

from skystack.reproduction.pieces import once


class Maker:
    """Writes a file and counts its calls."""

    def __init__(self, folder):
        self.path, self.calls = folder / "made", 0

    def __call__(self):
        self.calls += 1
        self.path.write_text(f"number {self.calls}")
        return {"number": self.calls}


@pytest.fixture
def maker(tmp_path):
    return Maker(tmp_path)


def test_finished_piece_is_not_repeated(maker, tmp_path):
    record = tmp_path / "record.json"
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 1}, False)
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 1}, True)
    assert maker.calls == 1


@pytest.mark.parametrize(
    "damage",
    [
        lambda maker, record: maker.path.write_text("something else"),
        lambda maker, record: maker.path.unlink(),
        lambda maker, record: record.write_text("{"),
        lambda maker, record: record.write_text("[]"),
        lambda maker, record: record.write_text('{"key": {"a": 1}, "result": 5}'),
        lambda maker, record: record.unlink(),
    ],
)
def test_damaged_piece_is_repeated(maker, tmp_path, damage):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])
    damage(maker, record)
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, False)
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, True)


def test_piece_with_another_key_is_repeated(maker, tmp_path):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])
    assert once(record, {"a": 2}, maker, ["made"]) == ({"number": 2}, False)


@pytest.mark.parametrize("files", [{}, {"../made": "0"}, {"/dev/zero": "0"}, {"made": 3}])
def test_record_does_not_decide_which_files_are_read(maker, tmp_path, files):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])
    stored = json.loads(record.read_text())
    stored["files"] |= files
    record.write_text(json.dumps(stored if files else stored | {"files": {}}))
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, False)


def test_failed_piece_leaves_no_record(maker, tmp_path):
    record = tmp_path / "record.json"
    once(record, {"a": 1}, maker, ["made"])

    def fail():
        maker.path.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        once(record, {"a": 2}, fail, ["made"])
    assert once(record, {"a": 1}, maker, ["made"]) == ({"number": 2}, False)
