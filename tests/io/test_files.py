"""Files are written whole or not at all, whatever is killed."""

import os
import resource
from contextlib import contextmanager
from pathlib import Path

import pytest

from skystack.errors import InputError
from skystack.io.files import append_line, atomic_write, check_output


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
    atomic_write(path, b"old")
    why = "file: cannot be written: File too large"
    with largest_file(1000), pytest.raises(InputError, match=why):
        atomic_write(path, b"x" * 2000)
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


def test_no_pipe_or_device_is_replaced_by_a_file(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe: cannot be written: it is not a regular file"):
        atomic_write(pipe, b"x")
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
    atomic_write(tmp_path / "file", b"")
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o666 & ~mask


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path):
    path = tmp_path / ("é" * 127)  # 254 bytes of 255
    atomic_write(path, b"data")
    assert path.read_bytes() == b"data"
    assert list(tmp_path.iterdir()) == [path]


def test_a_symbolic_link_is_replaced_and_not_followed(tmp_path):
    """A run folder may be untrusted: its links must not lead to the user's files."""
    (tmp_path / "mine").write_bytes(b"mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    atomic_write(tmp_path / "link", b"new")
    assert not (tmp_path / "link").is_symlink()
    assert (tmp_path / "mine").read_bytes() == b"mine"


@pytest.mark.parametrize("output", ["", ".", "..", "folder", "folder/.", "folder/.."])
def test_a_folder_is_refused_as_output(output, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for check in (check_output, lambda path: atomic_write(path, b"")):
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
