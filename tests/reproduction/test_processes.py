"""Worker processes: they end with their parent, and their temporary files are deleted."""

import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from skystack.learning.experiment import load_experiment
from skystack.reproduction.jobs import Job
from skystack.reproduction.plan import Plan
from skystack.reproduction.processes import _cleanup_on_failure, _listen
from tests.waiting import TIMEOUT_S, wait_until

PARENT = """
import multiprocessing
from tests.reproduction.test_processes import wait

if __name__ == "__main__":
    worker = multiprocessing.get_context("spawn").Process(target=wait)
    worker.start()
    worker.join()
"""
LOCK_HOLDER = """
import sys
from pathlib import Path
from filelock import FileLock
from skystack.io.locks import LOCK
lock = FileLock(Path(sys.argv[1]) / LOCK)
lock.acquire()
print(1, flush=True)
sys.stdin.read()
"""


def wait():
    """The work of a worker: print its process number and wait."""
    import os

    from skystack.io.parents import end_with_parent

    end_with_parent()
    sys.stdout.write(f"{os.getpid()}\n")
    sys.stdout.flush()
    time.sleep(10 * TIMEOUT_S)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
def test_a_worker_ends_when_its_parent_is_killed():
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    with parent:
        worker = Path("/proc", parent.stdout.readline().strip())
        assert worker.exists()
        parent.send_signal(signal.SIGKILL)
    wait_until(lambda: not worker.exists())


def test_deletes_temporary_files_except_in_locked_folders(tmp_path):
    lateral = load_experiment("lateral")
    plan = Plan((lateral,), 2, 3, tmp_path, True, "")
    ours, theirs = (Job(plan, lateral, seed) for seed in range(2))
    temporary_files = [".policy.json.abc.aside", "checkpoint/.learner.safetensors.abc.aside"]
    for job in (ours, theirs):
        for path in (job.folders[0] / name for name in temporary_files):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("half")
    with (
        locked_elsewhere(theirs.folders[0]),
        pytest.raises(KeyboardInterrupt),
        _cleanup_on_failure([ours, theirs]),
    ):
        raise KeyboardInterrupt
    assert not list(ours.folders[0].rglob("*.aside"))
    assert len(list(theirs.folders[0].rglob("*.aside"))) == 2


@contextmanager
def locked_elsewhere(folder):
    """The folder is locked by another process, which deletes nothing."""
    with subprocess.Popen(
        [sys.executable, "-c", LOCK_HOLDER, folder], stdin=-1, stdout=-1
    ) as other:
        assert other.stdout.readline() == b"1\n"
        yield
        other.stdin.close()


@pytest.mark.parametrize("error", [EOFError, BrokenPipeError, ConnectionResetError])
def test_listener_ends_quietly_when_the_queue_is_gone(error):
    class Messages:
        def __init__(self):
            self.remaining = [("lateral-s0", 1)]

        def get(self):
            if self.remaining:
                return self.remaining.pop()
            raise error

    reported = []
    _listen(Messages(), lambda *message: reported.append(message))
    assert reported == [("lateral-s0", 1)]
