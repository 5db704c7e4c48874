"""Files are read up to a size, written aside and renamed, folders locked: nothing half-written."""

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skystack.errors import InputError

try:
    import fcntl
except ImportError:  # not a POSIX system: nobody is locked out there
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""The file in a run folder that whoever works there holds locked; it stays, the lock does not."""
_ASIDE = ".aside"
MOST_BYTES = 64_000_000


def read_whole(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """A whole file. Raises InputError when it is no file, cannot be read or is too large."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError("cannot be read (it is no plain file)")  # a pipe would be waited for
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a ValueError for a null byte in the name
        raise InputError(f"cannot be read ({_reason(error)})") from None
    if len(data) > most_bytes:
        raise InputError(f"is too large (allowed: {most_bytes // 1_000_000} MB)")
    return data


def write_aside(path: Path, data: bytes) -> None:
    """Write a whole file or none, on the disk when this returns: a power cut leaves the old one.

    Raises InputError when it cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(_ASIDE, f".{path.name}.", path.parent)
    except (OSError, ValueError) as error:  # a ValueError for a null byte in the name
        raise _not_written(path, error) from None
    aside = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        aside.chmod(0o644)
        aside.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise _not_written(path, error) from None
    finally:
        aside.unlink(missing_ok=True)


def append_line(file: int, path: Path, line: str) -> None:
    """Write a line at the end of an open file, at once. Raises InputError when it cannot be."""
    data = line.encode() + b"\n"
    try:
        while data:  # a disk that fills up takes a part first, then says why not the rest
            data = data[os.write(file, data) :]
    except OSError as error:
        raise _not_written(path, error) from None


def check_folder_of(output: Path) -> None:
    """Raise InputError unless the folder of a file to be written is there (`-o` makes none)."""
    if not output.parent.is_dir():
        raise InputError(f"{output}: the folder {output.parent} does not exist")


def make_folder(path: Path) -> Path:
    """Create a folder for output, and its parents. Raises InputError when that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # a ValueError for a null byte in the name
        raise InputError(f"{path}: cannot be made a folder: {_reason(error)}") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder cannot be written to")
    return path


@contextmanager
def alone_in(folder: Path, below: Iterable[str] = ()) -> Iterator[None]:
    """Within it, no other process works in a run folder, which is made where there is none.

    The system itself lets go of the lock when the process ends, however it ends. What killed
    processes left aside in the folder is deleted, and in those `below` it (patterns) that belong to
    the same run. Raises InputError when another process holds the lock.
    """
    try:
        handle = os.open(make_folder(folder) / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise _not_written(folder / LOCK, error) from None
    try:
        _lock(handle, folder)
        for each in (folder, *(found for name in below for found in folder.glob(name))):
            for left in each.glob(f".*{_ASIDE}"):
                left.unlink(missing_ok=True)
        yield
    finally:
        os.close(handle)


def is_scratch(path: Path) -> bool:
    """Whether a file in a run folder is a lock, or was left aside by a process that was killed."""
    return path.name == LOCK or path.suffix == _ASIDE


def _lock(handle: int, folder: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            f"{folder}: another skystack is at work in this folder (allowed: another one by "
            "--out, or to wait for it)"
        ) from None
    except OSError:
        pass  # a file system without locks


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # not every system can; the file itself is safe
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _not_written(path: Path, error: OSError | ValueError) -> InputError:
    return InputError(f"{path}: cannot be written: {_reason(error)}")


def _reason(error: OSError | ValueError) -> str | None:
    return error.strerror if isinstance(error, OSError) else str(error)
