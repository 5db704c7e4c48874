"""`metrics.jsonl` beside a checkpoint: neither gap nor double, whatever was killed when."""

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
def test_lines_beyond_the_checkpoint_are_cut_off_whole_or_half(tmp_path, torn):
    path = tmp_path / "metrics.jsonl"
    write(path, 0, 4)
    path.write_text(path.read_text() + torn)
    write(path, 2, 3)
    assert updates(path) == [1, 2, 3]


def test_time_goes_on_from_the_last_line_that_is_kept(tmp_path):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"update": 1, "wall_s": 100.0}\n{"update": 2, "wall_s": 900.0}\n')
    write(path, 1, 2)
    walls = [json.loads(line)["wall_s"] for line in path.read_text().splitlines()]
    assert walls[0] == 100.0
    assert 100.0 < walls[1] < 900.0


@pytest.mark.parametrize("lines", [[1, 2], [1, 2, 2], [1, 3, 4], []])
def test_a_checkpoint_without_its_lines_is_refused_and_nothing_changed(tmp_path, lines):
    path = tmp_path / "metrics.jsonl"
    text = "".join(f'{{"update": {number}, "wall_s": 1.0}}\n' for number in lines)
    path.write_text(text)
    with pytest.raises(CheckpointError, match="does not hold the 3 updates"):
        MetricsFile(path, 3, 0.0)
    assert path.read_text() == text
