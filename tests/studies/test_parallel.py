"""Pieces of a study in processes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from studies.parallel import INTERRUPTED, run_pieces
from tests.waiting import wait_until

ROOT = Path(__file__).parents[2]


def describe(name, number):
    if number < 0:
        raise ValueError(name)
    return f"{name} {number}"


@pytest.mark.slow
def test_results_are_in_the_order_of_the_pieces(capsys):
    pieces = [("a", 1), ("b", 2), ("c", 3)]
    assert run_pieces(describe, pieces, "pieces") == ["a 1", "b 2", "c 3"]
    assert "3 of 3 pieces finished, 0 min" in capsys.readouterr().err


@pytest.mark.slow
def test_a_failed_piece_fails_the_study():
    with pytest.raises(ValueError, match="bad"):
        run_pieces(describe, [("a", 1), ("bad", -1), ("c", 3)], "pieces")


def report_and_wait(folder):
    Path(folder, str(os.getpid())).touch()
    signal.pause()


def is_running(pid):
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


@pytest.fixture
def study(tmp_path):
    """A study in its own session, whose only piece waits, and the process id of its worker."""
    code = (
        # A test run in the background ignores Ctrl-C, and so would the study.
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from tests.studies.test_parallel import report_and_wait\n"
        "from studies.parallel import run_pieces\n"
        f"run_pieces(report_and_wait, [({str(tmp_path)!r},)], 'pieces')"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: any(tmp_path.iterdir()))
    worker = int(next(tmp_path.iterdir()).name)
    assert is_running(worker)
    yield process, worker
    process.kill()
    process.stderr.close()


@pytest.mark.slow
def test_workers_end_if_the_study_is_killed(study):
    process, worker = study
    process.kill()
    process.wait()
    wait_until(lambda: not is_running(worker))


@pytest.mark.slow
def test_says_that_it_resumes_after_an_interruption(study):
    process, worker = study
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == INTERRUPTED
    assert process.stderr.read() == "interrupted: run the same command again to resume\n"
    wait_until(lambda: not is_running(worker))
