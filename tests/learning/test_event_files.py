"""Event files say what `metrics.jsonl` says, each step once."""

import json
import struct
import sys
import time
from contextlib import suppress

import pytest

from skystack.errors import InputError
from skystack.learning.event_files import event_files

pytest.importorskip("tensorboardX")

LINES = [
    {"update": n, "steps": 256 * n, "wall_s": 2.0 * n, "success": n / 8.0, "kl": 0.5 / n}
    for n in (1, 2, 3, 4)
]


def append(run, lines):
    with (run / "metrics.jsonl").open("a") as file:
        file.writelines(json.dumps(line) + "\n" for line in lines)


def events(run):
    """All events of the folder: records of a length, its sum of four bytes, data, and its sum."""
    from tensorboardX.proto.event_pb2 import Event

    found = []
    for path in sorted((run / "tensorboard").iterdir()):
        data = path.read_bytes()
        while data:
            (length,) = struct.unpack_from("<Q", data)
            found.append(Event.FromString(data[12 : 12 + length]))
            data = data[16 + length :]
    return found


def scalars(run):
    return [
        (value.tag, event.step, pytest.approx(value.simple_value))
        for event in events(run)
        for value in event.summary.value
    ]


def told(lines):
    return [(name, line["steps"], line[name]) for line in lines for name in ("success", "kl")]


def test_every_metric_of_every_update_is_a_scalar_at_its_step(tmp_path):
    with event_files(tmp_path) as follow:
        for line in LINES:
            append(tmp_path, [line])
            follow()
    assert scalars(tmp_path) == told(LINES)


def test_what_was_trained_before_lies_in_the_past(tmp_path):
    append(tmp_path, LINES)
    before = time.time()
    with event_files(tmp_path):
        pass
    after = time.time()
    times = {event.step: event.wall_time for event in events(tmp_path) if event.summary.value}
    for number, ago in enumerate((6.0, 4.0, 2.0, 0.0), 1):
        assert before <= times[256 * number] + ago <= after


def test_what_was_not_measured_is_left_out(tmp_path):
    append(tmp_path, [LINES[0] | {"success": None}, LINES[1]])
    with event_files(tmp_path):
        pass
    assert scalars(tmp_path) == told(LINES[:2])[1:]


def interrupted(run):
    with suppress(KeyboardInterrupt), event_files(run) as follow:
        append(run, LINES[:3])
        follow()
        raise KeyboardInterrupt


def test_a_resumed_training_doubles_no_step(tmp_path):
    """Broken off after three updates, of which the checkpoint knows two."""
    interrupted(tmp_path)
    assert scalars(tmp_path) == told(LINES[:3])
    with event_files(tmp_path) as follow:
        (tmp_path / "metrics.jsonl").write_text("")
        append(tmp_path, LINES[:2])
        append(tmp_path, [LINES[2]])
        follow()
        append(tmp_path, [LINES[3]])
        follow()
    assert scalars(tmp_path) == told(LINES)


def test_a_training_that_never_began_leaves_the_events_of_the_one_before(tmp_path):
    append(tmp_path, LINES)
    with event_files(tmp_path):
        pass
    with pytest.raises(InputError), event_files(tmp_path):
        raise InputError("a checkpoint of another configuration")
    assert scalars(tmp_path) == told(LINES)


def test_an_extra_that_is_missing_is_named_before_anything_is_done(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with (
        pytest.raises(InputError, match=r"the extra \[tensorboard\]"),
        event_files(tmp_path / "run"),
    ):
        pytest.fail("training begun")
    assert list(tmp_path.iterdir()) == []
