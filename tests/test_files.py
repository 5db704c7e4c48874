"""Files are whole or not there, and folders have one at work in them, whatever is killed."""

import os
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from skystack.errors import InputError
from skystack.files import alone_in, append_line, is_scratch, write_aside

HOLDER = """
import sys, time
from pathlib import Path
from skystack.files import alone_in
with alone_in(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(1e6)
"""


@contextmanager
def largest_file(size):
    """Within it no file gets larger, in bytes: as a full disk, for one process."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:  # before anything is said of the test, perhaps into a file
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "file"
    write_aside(path, b"old")
    why = "file: cannot be written: File too large"
    with largest_file(1000), pytest.raises(InputError, match=why):
        write_aside(path, b"x" * 2000)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_line_that_has_no_room_is_an_error(tmp_path):
    path = tmp_path / "lines"
    path.touch()
    file = os.open(path, os.O_WRONLY | os.O_APPEND)
    append_line(file, path, "first")
    why = "lines: cannot be written: File too large"
    with largest_file(10), pytest.raises(InputError, match=why):
        append_line(file, path, "second")
    os.close(file)
    assert path.read_bytes() == b"first\nseco"


def test_a_folder_has_one_at_work_until_that_one_is_killed(tmp_path):
    held = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    with held:
        assert held.stdout.readline() == "held\n"
        with (
            pytest.raises(InputError, match=f"^{tmp_path}: another skystack is at work"),
            alone_in(tmp_path),
        ):
            pass
        held.send_signal(signal.SIGKILL)
    with alone_in(tmp_path):
        pass
    with alone_in(tmp_path):
        pass


def test_what_was_left_aside_goes_in_the_run_s_own_folders_only(tmp_path):
    parts = ("", "own", "other")
    for part in parts:
        (tmp_path / part).mkdir(exist_ok=True)
        (tmp_path / part / ".policy.json.abc.aside").write_text("half")
        (tmp_path / part / "policy.json").write_text("whole")
    with alone_in(tmp_path, below=("own",)):
        pass
    left = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    scratch = {str(path) for path in left if is_scratch(path)}
    assert scratch == {".lock", "other/.policy.json.abc.aside"}
    assert {str(path) for path in left} - scratch == {
        "policy.json",
        "own/policy.json",
        "other/policy.json",
    }
