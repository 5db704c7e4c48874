"""TensorBoard event files contain every line of `metrics.jsonl` exactly once."""

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
    """All events of the run. A record is a length, its 4-byte checksum, data and their checksum."""
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


def expected(lines):
    return [(name, line["steps"], line[name]) for line in lines for name in ("success", "kl")]


def test_writes_every_metric_of_every_update_at_its_step(tmp_path):
    with event_files(tmp_path) as follow:
        for line in LINES:
            append(tmp_path, [line])
            follow()
    assert scalars(tmp_path) == expected(LINES)


def test_earlier_updates_keep_their_times(tmp_path, monkeypatch):
    append(tmp_path, LINES)
    monkeypatch.setattr(time, "time", lambda: 1_000_000.0)
    with event_files(tmp_path):
        pass
    times = {event.step: event.wall_time for event in events(tmp_path) if event.summary.value}
    assert [times[256 * n] - 1_000_000.0 for n in (1, 2, 3, 4)] == [-6.0, -4.0, -2.0, 0.0]


def test_omits_missing_metrics(tmp_path):
    append(tmp_path, [LINES[0] | {"success": None}, LINES[1]])
    with event_files(tmp_path):
        pass
    assert scalars(tmp_path) == expected(LINES[:2])[1:]


def interrupt_after_three_updates(run):
    with suppress(KeyboardInterrupt), event_files(run) as follow:
        append(run, LINES[:3])
        follow()
        raise KeyboardInterrupt


def test_resumed_training_writes_each_step_once(tmp_path):
    """The run was interrupted after three updates, but its checkpoint contains only two."""
    interrupt_after_three_updates(tmp_path)
    assert scalars(tmp_path) == expected(LINES[:3])
    with event_files(tmp_path) as follow:
        (tmp_path / "metrics.jsonl").write_text("")
        append(tmp_path, LINES[:2])
        append(tmp_path, [LINES[2]])
        follow()
        append(tmp_path, [LINES[3]])
        follow()
    assert scalars(tmp_path) == expected(LINES)


def test_failed_start_keeps_the_events_of_the_last_run(tmp_path):
    append(tmp_path, LINES)
    with event_files(tmp_path):
        pass
    with pytest.raises(InputError), event_files(tmp_path):
        raise InputError("the checkpoint has another configuration")
    assert scalars(tmp_path) == expected(LINES)


def test_names_a_missing_extra_before_training(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with (
        pytest.raises(InputError, match=r"the extra \[tensorboard\]"),
        event_files(tmp_path / "run"),
    ):
        pytest.fail("training has started")
    assert list(tmp_path.iterdir()) == []
