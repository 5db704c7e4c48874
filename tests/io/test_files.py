"""Files are written completely or not at all."""

import os
import resource
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

import pytest

from skystack.errors import InputError
from skystack.io.files import append_line, atomic_files, atomic_write, check_output, file_digest


@contextmanager
def file_size_limit(size):
    """Limit the size of files in bytes inside the context; simulates a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:  # before pytest reports, perhaps to a file
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_failed_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "file"
    atomic_write(path, b"old")
    reason = "file: cannot be written: File too large"
    with file_size_limit(1000), pytest.raises(InputError, match=reason):
        atomic_write(path, b"x" * 2000)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_outdated_files_are_deleted_only_if_all_new_ones_are_written(tmp_path):
    paths, outdated = [tmp_path / "one", tmp_path / "two"], tmp_path / "about-them"
    for path in (*paths, outdated):
        path.write_bytes(b"old")

    def write(sizes):
        with atomic_files(paths, [outdated]) as files:
            for file, size in zip(files, sizes, strict=True):
                file.write(b"x" * size)

    with file_size_limit(1000), pytest.raises(InputError, match="two: cannot be written"):
        write((10, 2000))
    assert {path.read_bytes() for path in (*paths, outdated)} == {b"old"}
    write((3, 3))
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == dict.fromkeys(paths, b"xxx")


def test_digests_are_of_the_present_content(tmp_path):
    for content in (b"one", b"two"):
        (tmp_path / "file").write_bytes(content)
        assert file_digest(tmp_path / "file") == sha256(content).hexdigest()
    for unreadable in (tmp_path / "missing", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            file_digest(unreadable)


def test_append_without_space_is_an_error(tmp_path):
    path = tmp_path / "lines"
    path.touch()
    file = os.open(path, os.O_WRONLY | os.O_APPEND)
    append_line(file, path, "first")
    reason = "lines: cannot be written: File too large"
    with file_size_limit(10), pytest.raises(InputError, match=reason):
        append_line(file, path, "second")
    os.close(file)
    assert path.read_bytes() == b"first\nseco"


def test_refuses_to_replace_a_pipe(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe: cannot be written: it is not a regular file"):
        atomic_write(pipe, b"x")
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.fixture
def umask():
    """A function that sets the umask; the previous one is restored."""
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_new_files_follow_the_umask(mask, umask, tmp_path):
    umask(mask)
    atomic_write(tmp_path / "file", b"")
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o666 & ~mask


def test_allows_the_longest_name_of_the_system(tmp_path):
    path = tmp_path / ("é" * 127)  # 254 bytes; the limit is 255
    atomic_write(path, b"data")
    assert path.read_bytes() == b"data"
    assert list(tmp_path.iterdir()) == [path]


def test_replaces_a_symbolic_link_without_following_it(tmp_path):
    """A run folder may be untrusted: its links must not lead to the user's files."""
    (tmp_path / "mine").write_bytes(b"mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    atomic_write(tmp_path / "link", b"new")
    assert not (tmp_path / "link").is_symlink()
    assert (tmp_path / "mine").read_bytes() == b"mine"


@pytest.mark.parametrize("output", ["", ".", "..", "folder", "folder/.", "folder/.."])
def test_rejects_a_folder_as_output(output, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for check in (check_output, lambda path: atomic_write(path, b"")):
        with pytest.raises(InputError, match=r"cannot be written: it is a folder$"):
            check(Path(output))
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "folder"]


def test_output_must_not_overwrite_an_input(tmp_path):
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
