"""Files are whole or not there, and one process at a time works in a folder, whatever is killed."""

import os
import resource
import signal
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from skystack import files
from skystack.errors import InputError
from skystack.files import (
    alone_in,
    append_line,
    check_output,
    is_scratch,
    no_empty_folders,
    write_aside,
)

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
            pytest.raises(InputError, match=f"^{tmp_path}: is in use by another process"),
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


def fail_in(folder, error, write):
    with alone_in(folder):
        write(folder)
        raise error


@pytest.mark.parametrize("inner", ["", "inner"])
def test_a_failure_deletes_nothing_where_another_process_is_at_work(tmp_path, inner):
    """Two commands start at once: the refused one must not delete the other's empty folders."""
    new = tmp_path / "new"

    def both(stack):
        with no_empty_folders(new):
            stack.enter_context(alone_in(new / inner))
            (new / inner / "checkpoint").mkdir()
            stack.enter_context(alone_in(new / inner))

    with ExitStack() as stack:
        with pytest.raises(InputError, match="is in use"):
            both(stack)
        assert (new / inner / "checkpoint").is_dir()


def test_a_folder_that_another_process_deletes_before_it_is_locked_is_made_again(
    tmp_path, monkeypatch
):
    opened = os.open

    def deleted(path, *arguments):
        monkeypatch.setattr(files.os, "open", opened)
        (tmp_path / "new").rmdir()
        return opened(path, *arguments)

    monkeypatch.setattr(files.os, "open", deleted)
    with alone_in(tmp_path / "new"):
        assert (tmp_path / "new" / ".lock").exists()


def test_a_lock_that_is_a_link_is_refused(tmp_path):
    """A run folder may be untrusted: no file is made where the link leads."""
    (tmp_path / "run").mkdir()
    for target in (tmp_path / "elsewhere", tmp_path / "nowhere" / "file"):
        (tmp_path / "run" / ".lock").symlink_to(target)
        with pytest.raises(InputError, match="cannot be written"), alone_in(tmp_path / "run"):
            pass
        assert [path.name for path in tmp_path.iterdir()] == ["run"]
        (tmp_path / "run" / ".lock").unlink()


def write_new(folder):
    (folder / "inner").mkdir()
    if folder.name == "new":
        (folder / "inner" / "config.toml").touch()


@pytest.mark.parametrize("error", [InputError("no"), KeyboardInterrupt()])
def test_a_failure_leaves_no_folder_that_holds_nothing(tmp_path, error):
    (tmp_path / "there").mkdir()
    for run in (tmp_path / "runs" / "run", tmp_path / "there" / "run"):
        with pytest.raises(type(error)):
            fail_in(run, error, lambda run: (run / "checkpoint").mkdir())
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    assert list((tmp_path / "there").iterdir()) == []


def test_a_failure_keeps_what_was_written_and_what_was_there(tmp_path):
    (tmp_path / "old" / "empty").mkdir(parents=True)
    for folder in ("old", "new"):
        with pytest.raises(InputError):
            fail_in(tmp_path / folder, InputError("no"), write_new)
    assert (tmp_path / "old" / "empty").is_dir()
    assert (tmp_path / "new" / "inner" / "config.toml").exists()
    assert (tmp_path / "new" / ".lock").exists()


def test_a_lock_that_is_deleted_before_it_is_held_is_made_again(tmp_path, monkeypatch):
    """As when another process fails between our opening its lock file and its letting go."""
    held = files._lock

    def deleted(handle, folder):
        monkeypatch.setattr(files, "_lock", held)
        (folder / ".lock").unlink()

    monkeypatch.setattr(files, "_lock", deleted)
    with alone_in(tmp_path), pytest.raises(InputError, match="is in use"), alone_in(tmp_path):
        pass


def test_no_pipe_or_device_is_replaced_by_a_file(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe: cannot be written: it is not a regular file"):
        write_aside(pipe, b"x")
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.fixture
def umask():
    """Sets the umask; the previous one is restored."""
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_new_files_follow_the_umask(mask, umask, tmp_path):
    umask(mask)
    write_aside(tmp_path / "file", b"")
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path):
    path = tmp_path / ("é" * 127)  # 254 bytes of 255
    write_aside(path, b"data")
    assert path.read_bytes() == b"data"
    assert list(tmp_path.iterdir()) == [path]


def test_a_symbolic_link_is_replaced_and_not_followed(tmp_path):
    """A run folder may be untrusted: its links must not lead to the user's files."""
    (tmp_path / "mine").write_bytes(b"mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    write_aside(tmp_path / "link", b"new")
    assert not (tmp_path / "link").is_symlink()
    assert (tmp_path / "mine").read_bytes() == b"mine"


@pytest.mark.parametrize("output", ["", ".", "..", "folder", "folder/.", "folder/.."])
def test_a_folder_is_refused_as_output(output, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for check in (check_output, lambda path: write_aside(path, b"")):
        with pytest.raises(InputError, match=r"cannot be written: it is a folder$"):
            check(Path(output))
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "folder"]


def test_an_output_may_not_overwrite_its_input(tmp_path):
    source, other, link = (tmp_path / name for name in ("source", "other", "link"))
    source.touch()
    other.touch()
    link.symlink_to(source)
    for output in (source, tmp_path / "." / "source", link):
        with pytest.raises(InputError, match=r": is also an input \(allowed"):
            check_output(output, other, source)
    for output in (other, tmp_path / "new"):
        check_output(output, source, tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"the folder .*nowhere does not exist$"):
        check_output(tmp_path / "nowhere" / "new", source)
