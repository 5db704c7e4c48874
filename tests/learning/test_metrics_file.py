"""`metrics.jsonl` matches the checkpoint: no gaps or duplicates, whenever a run was killed."""

import json
import time

import pytest

from skystack.errors import CheckpointError
from skystack.learning.metrics_file import MetricsFile


def write(path, first, last):
    metrics = MetricsFile(path, first, time.monotonic())
    for number in range(first + 1, last + 1):
        metrics.append({"update": number}, {"value_loss": 0.5})
    metrics.close()


def updates(path):
    return [json.loads(line)["update"] for line in path.read_text().splitlines()]


@pytest.mark.parametrize("torn", ["", '{"update": 5, "wal', "\n", "\x00\x00"])
def test_removes_whole_and_torn_lines_beyond_the_checkpoint(tmp_path, torn):
    path = tmp_path / "metrics.jsonl"
    write(path, 0, 4)
    path.write_text(path.read_text() + torn)
    write(path, 2, 3)
    assert updates(path) == [1, 2, 3]


def test_wall_time_continues_from_the_last_kept_line(tmp_path, monkeypatch):
    path = tmp_path / "metrics.jsonl"
    lines = [
        {"update": number + 1, "wall_s": wall_s} for number, wall_s in enumerate((60, 100, 900))
    ]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    clock = [5000.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    metrics = MetricsFile(path, 2, time.monotonic())
    clock[0] += 7.0
    assert metrics.wall_s() == 107.0
    metrics.append({"update": 3}, {})
    metrics.close()
    walls = [json.loads(line)["wall_s"] for line in path.read_text().splitlines()]
    assert walls == [60, 100, 107.0]


@pytest.mark.parametrize("lines", [[1, 2], [1, 2, 2], [1, 3, 4], []])
def test_rejects_missing_lines_and_changes_nothing(tmp_path, lines):
    path = tmp_path / "metrics.jsonl"
    text = "".join(f'{{"update": {number}, "wall_s": 1.0}}\n' for number in lines)
    path.write_text(text)
    with pytest.raises(CheckpointError, match=r"the 3 updates of .* .allowed: another folder"):
        MetricsFile(path, 3, 0.0)
    assert path.read_text() == text
