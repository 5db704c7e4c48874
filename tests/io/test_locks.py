"""One process at a time uses a run folder, and a failed one leaves no empty folders."""

import fcntl
import os
import signal
import subprocess
import sys
from contextlib import ExitStack

import pytest

from skystack.errors import InputError
from skystack.io.locks import delete_empty_on_failure, is_scratch, locked_folder

HOLDER = """
import sys, time
from pathlib import Path
from skystack.io.locks import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(1e6)
"""


def test_folder_is_locked_until_its_process_is_killed(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    with holder:
        assert holder.stdout.readline() == "held\n"
        with (
            pytest.raises(InputError, match=f"^{tmp_path}: is in use by another process"),
            locked_folder(tmp_path),
        ):
            pass
        holder.send_signal(signal.SIGKILL)
    with locked_folder(tmp_path):
        pass
    with locked_folder(tmp_path):
        pass


def test_deletes_temporary_files_only_in_own_folders(tmp_path):
    parts = ("", "own", "other")
    for part in parts:
        (tmp_path / part).mkdir(exist_ok=True)
        (tmp_path / part / ".policy.json.abc.aside").write_text("half")
        (tmp_path / part / "policy.json").write_text("whole")
    with locked_folder(tmp_path, below=("own",)):
        pass
    remaining = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    scratch = {str(path) for path in remaining if is_scratch(path)}
    assert scratch == {".lock", "other/.policy.json.abc.aside"}
    assert {str(path) for path in remaining} - scratch == {
        "policy.json",
        "own/policy.json",
        "other/policy.json",
    }


def fail_in(folder, error, write):
    with locked_folder(folder):
        write(folder)
        raise error


@pytest.mark.parametrize("inner", ["", "inner"])
def test_failure_deletes_nothing_that_another_process_uses(tmp_path, inner):
    """Two commands start at once: the rejected one must not delete empty folders of the other."""
    new = tmp_path / "new"

    def lock_twice(stack):
        with delete_empty_on_failure(new):
            stack.enter_context(locked_folder(new / inner))
            (new / inner / "checkpoint").mkdir()
            stack.enter_context(locked_folder(new / inner))

    with ExitStack() as stack:
        with pytest.raises(InputError, match="is in use"):
            lock_twice(stack)
        assert (new / inner / "checkpoint").is_dir()


def test_recreates_a_folder_deleted_before_it_is_locked(tmp_path, monkeypatch):
    original_open = os.open

    def delete_first(path, *arguments):
        monkeypatch.setattr(os, "open", original_open)
        (tmp_path / "new").rmdir()
        return original_open(path, *arguments)

    monkeypatch.setattr(os, "open", delete_first)
    with locked_folder(tmp_path / "new"):
        assert (tmp_path / "new" / ".lock").exists()


def test_rejects_a_lock_that_is_a_link(tmp_path):
    """A run folder may be untrusted: no file is created where the link points."""
    (tmp_path / "run").mkdir()
    for target in (tmp_path / "elsewhere", tmp_path / "nowhere" / "file"):
        (tmp_path / "run" / ".lock").symlink_to(target)
        with pytest.raises(InputError, match="cannot be written"), locked_folder(tmp_path / "run"):
            pass
        assert [path.name for path in tmp_path.iterdir()] == ["run"]
        (tmp_path / "run" / ".lock").unlink()


def write_new(folder):
    (folder / "inner").mkdir()
    if folder.name == "new":
        (folder / "inner" / "config.toml").touch()


@pytest.mark.parametrize("error", [InputError("no"), KeyboardInterrupt()])
def test_failure_leaves_no_empty_folders(tmp_path, error):
    (tmp_path / "there").mkdir()
    for run in (tmp_path / "runs" / "run", tmp_path / "there" / "run"):
        with pytest.raises(type(error)):
            fail_in(run, error, lambda run: (run / "checkpoint").mkdir())
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    assert list((tmp_path / "there").iterdir()) == []


def test_failure_keeps_written_files_and_earlier_folders(tmp_path):
    (tmp_path / "old" / "empty").mkdir(parents=True)
    for folder in ("old", "new"):
        with pytest.raises(InputError):
            fail_in(tmp_path / folder, InputError("no"), write_new)
    assert (tmp_path / "old" / "empty").is_dir()
    assert (tmp_path / "new" / "inner" / "config.toml").exists()
    assert (tmp_path / "new" / ".lock").exists()


def test_recreates_a_lock_file_deleted_before_it_is_locked(tmp_path, monkeypatch):
    """This happens if another process fails after we opened its lock file."""
    original_flock = fcntl.flock

    def delete_first(handle, operation):
        monkeypatch.setattr(fcntl, "flock", original_flock)
        (tmp_path / ".lock").unlink()
        original_flock(handle, operation)

    monkeypatch.setattr(fcntl, "flock", delete_first)
    with (
        locked_folder(tmp_path),
        pytest.raises(InputError, match="is in use"),
        locked_folder(tmp_path),
    ):
        pass
