"""One terminated training, and the faults that the study must detect."""

import signal
import sys
import time

import pytest

from verification.robustness import signalled_commands
from verification.robustness.signalled_commands import SIGNALLED, Place, signalled

# The children execute another program at once, so JAX does not run in them after the fork.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

PROGRAM = """
import os, pathlib, signal, subprocess, sys, time
folder, cache = pathlib.Path(sys.argv[1]), pathlib.Path(os.environ["SKYSTACK_CACHE"])
child = "import time; print(flush=True); time.sleep(600)"
def leave_a_child():
    subprocess.Popen([sys.executable, "-c", child], stdout=subprocess.PIPE).stdout.readline()
signal.signal(signal.SIGTERM, lambda *_: {on_signal})
(folder / "ready.jsonl").touch()
while True:
    time.sleep(0.01)
"""
FAULTS = {
    "os._exit(0)": "exit code 0 after SIGTERM",
    "os._exit(130)": "exit code 130 after SIGTERM",
    "1 / 0": "exit code 1 after SIGTERM",
    "(print('Traceback', file=sys.stderr, flush=True), os._exit(143))": "a traceback",
    "((folder / '.a.b.aside').touch(), os._exit(143))": "left behind",
    "((cache / 'running-1').mkdir(parents=True), os._exit(143))": "left behind",
    "((folder / 'a.json').write_text('{'), os._exit(143))": "half-written",
    "(leave_a_child(), os._exit(143))": "running",
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYSTACK_CACHE", str(tmp_path / "programs"))
    monkeypatch.setattr(signalled_commands, "ORPHAN_S", 0.0)
    (tmp_path / "work").mkdir()
    return Place(tmp_path / "work", tmp_path, tmp_path)


@pytest.mark.slow
def test_terminated_training_ends_cleanly(place):
    metrics = place.folder / "run" / "metrics.jsonl"
    command = SIGNALLED["train"].command(place)
    ended = signalled(
        command, place, signal.SIGTERM, False, lambda: metrics.exists() and metrics.read_bytes()
    )
    assert ended == ("code", ())
    assert (place.folder / "run" / "checkpoint" / "learner.safetensors").exists()


@pytest.mark.parametrize("on_signal", ["os._exit(143)", *FAULTS])
def test_detects_every_fault(place, on_signal):
    ready = place.folder / "ready.jsonl"
    program = PROGRAM.format(on_signal=on_signal)
    command = [sys.executable, "-c", program, str(place.folder)]
    ended = signalled(command, place, signal.SIGTERM, False, ready.exists)
    assert ended.how == "code"
    if on_signal in FAULTS:
        assert FAULTS[on_signal] in ended.wrong[0]
    else:
        assert ended.wrong == ()


def test_a_command_may_end_before_the_signal(place):
    ended = signalled([sys.executable, "-c", ""], place, signal.SIGTERM, False, never)
    assert ended == ("before", ())


def never():
    time.sleep(0.01)
    return False
