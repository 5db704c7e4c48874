"""Files are read up to a size, written aside and renamed, folders locked: nothing half-written."""

import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import takewhile
from os import PathLike
from pathlib import Path
from secrets import token_hex
from typing import IO

from skystack.errors import InputError, exists
from skystack.signals import held

try:
    import fcntl
except ImportError:  # not a POSIX system: nobody is locked out there
    fcntl = None  # type: ignore[assignment]

AnyPath = str | PathLike[str]
LOCK = ".lock"
"""The file in a run folder that whoever works there holds locked; it stays, the lock does not."""
_ASIDE = ".aside"
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
"""A run folder may be untrusted: its lock must not be a link to a file elsewhere."""
MOST_BYTES = 64_000_000


def read_whole(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """A whole file. Raises InputError when it is no file, cannot be read or is too large."""
    try:
        if exists(path) and not (path.is_file() or path.is_dir()):
            # Reading a pipe could block forever.
            raise InputError("cannot be read (it is not a regular file)")
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
    with held(), aside([path]) as [file], writing(path):
        file.write(data)


@contextmanager
def aside(paths: Sequence[Path]) -> Iterator[list[IO[bytes]]]:
    """Open temporary files that replace others, all together, when the context ends.

    They are synced to disk first. If anything is raised inside, the old files stay. Raises
    InputError for a file that cannot be written.
    """
    with ExitStack() as stack:
        files = [stack.enter_context(_open_aside(path)) for path in paths]
        yield files
        with held():
            for path, file in zip(paths, files, strict=True):
                with writing(path):
                    file.flush()
                    os.fsync(file.fileno())
            for path, file in zip(paths, files, strict=True):
                with writing(path):
                    Path(file.name).replace(path)
            for folder in {path.parent for path in paths}:
                _sync_folder(folder)


@contextmanager
def _open_aside(path: Path) -> Iterator[IO[bytes]]:
    if "\0" in str(path):
        raise _not_written(path, ValueError("a null byte in the name"))
    check_not_folder(path)
    if exists(path) and not path.is_file():
        # A rename would replace the device or pipe with a regular file.
        raise InputError(f"{path}: cannot be written: it is not a regular file")
    file: IO[bytes] | None = None
    try:
        with held(), writing(path):
            file = _unused(path).open("xb")
        yield file
    finally:
        if file is not None:
            with held():
                with suppress(OSError):  # a full disk has been reported by then
                    file.close()
                Path(file.name).unlink(missing_ok=True)


def _unused(path: Path) -> Path:
    """A random temporary name in the same folder, short even if the file's name is long."""
    return path.with_name(f".{path.name[:40]}.{token_hex(8)}{_ASIDE}")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn system errors inside the context into InputError: the file cannot be written."""
    try:
        yield
    except OSError as error:
        raise _not_written(path, error) from None


def append_line(file: int, path: Path, line: str) -> None:
    """Write a line at the end of an open file, at once. Raises InputError when it cannot be."""
    data = line.encode() + b"\n"
    try:
        while data:  # a disk that fills up takes a part first, then says why not the rest
            data = data[os.write(file, data) :]
    except OSError as error:
        raise _not_written(path, error) from None


def check_output(output: Path, *sources: Path) -> None:
    """Check an output path before the work starts.

    Raises InputError if its folder does not exist (`-o` creates none), or if it is a folder or one
    of `sources`.
    """
    check_not_folder(output)
    if not output.parent.is_dir():
        raise InputError(f"{output}: the folder {output.parent} does not exist")
    for source in sources:
        with suppress(OSError):  # usually the output does not exist yet
            if output.samefile(source):
                raise InputError(f"{output}: is also an input (allowed: another name)")


def check_not_folder(output: Path) -> None:
    """Raise InputError if an output path is a folder."""
    if output.name in ("", "..") or (exists(output) and output.is_dir()):
        raise InputError(f"{output}: cannot be written: it is a folder")


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
    the same run. A failure leaves no folder that holds nothing but the lock. Raises InputError when
    another process holds the lock.
    """
    with no_empty_folders(folder):
        handle = _open_locked(folder)
        try:
            for each in (folder, *(found for name in below for found in folder.glob(name))):
                for left in each.glob(f".*{_ASIDE}"):
                    left.unlink(missing_ok=True)
            yield
        except BaseException:
            if not any(path.is_file() for path in folder.rglob("*") if path != folder / LOCK):
                (folder / LOCK).unlink(missing_ok=True)  # while it is held
            raise
        finally:
            os.close(handle)


@contextmanager
def no_empty_folders(folder: Path) -> Iterator[None]:
    """On failure inside the context, delete folders that were created in it and hold no file.

    A folder that another process has locked stays as it is, and all that is in it.
    """
    missing = list(takewhile(lambda each: not each.exists(), (folder, *folder.parents)))
    try:
        yield
    except BaseException:
        for each in missing:
            _delete_empty(each)
        raise


def _delete_empty(folder: Path) -> None:
    with suppress(OSError, InputError), ExitStack() as stack:
        if (folder / LOCK).exists():
            stack.callback(os.close, _open_locked(folder))
        for inner in folder.iterdir():
            if inner.is_dir() and not inner.is_symlink():
                _delete_empty(inner)
        folder.rmdir()  # an OSError where it is not empty


@contextmanager
def scratch_folder(prefix: str, within: Path | None = None) -> Iterator[Path]:
    """A temporary folder, deleted afterwards; in the system's usual place unless one is given."""
    made: tempfile.TemporaryDirectory[str] | None = None
    try:
        with held():
            made = tempfile.TemporaryDirectory("", prefix, within, ignore_cleanup_errors=True)
        yield Path(made.name)
    finally:
        with held():
            if made is not None:
                made.cleanup()


def check_unused(folder: Path) -> None:
    """Raise InputError if another process has locked a folder."""
    if exists(folder / LOCK):
        os.close(_open_locked(folder))


def is_abandoned(folder: Path, idle_s: float) -> bool:
    """Whether a folder has been idle for a while and no process holds its lock."""
    if time.time() - folder.stat().st_mtime <= idle_s:
        return False
    try:
        os.close(_open_locked(folder))
    except InputError:
        return False
    return True


def is_scratch(path: Path) -> bool:
    """Whether a file in a run folder is a lock, or was left aside by a process that was killed."""
    return path.name == LOCK or path.suffix == _ASIDE


def _open_locked(folder: Path) -> int:
    """The lock file of a folder, open and locked."""
    path = folder / LOCK
    while True:
        make_folder(folder)
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o644)
        except FileNotFoundError:
            continue  # another process failed and deleted the folder, which was empty
        except OSError as error:
            raise _not_written(path, error) from None
        try:
            _lock(handle, folder)
            if _is_at(handle, path):
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # another process deleted it before it was ours


def _lock(handle: int, folder: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            f"{folder}: is in use by another process (allowed: another folder by --out, or to wait "
            "for it)"
        ) from None
    except OSError:
        pass  # a file system without locks


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


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
