"""Workers end with the process that began them, even when that is killed."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.waiting import HANGS_S, wait_until

PARENT = """
import multiprocessing
from tests.reproduction.test_processes import wait

if __name__ == "__main__":
    worker = multiprocessing.get_context("spawn").Process(target=wait)
    worker.start()
    worker.join()
"""


def wait():
    """What a worker does here."""
    import os

    from skystack.reproduction.processes import _end_with_parent

    _end_with_parent()
    sys.stdout.write(f"{os.getpid()}\n")
    sys.stdout.flush()
    time.sleep(10 * HANGS_S)


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
def test_a_worker_ends_when_its_parent_is_killed():
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    with parent:
        worker = Path("/proc", parent.stdout.readline().strip())
        assert worker.exists()
        parent.send_signal(signal.SIGKILL)
    wait_until(lambda: not worker.exists())
