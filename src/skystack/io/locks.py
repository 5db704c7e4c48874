"""Locks on run folders that are in use, and deletion of those that a failed run leaves empty."""

import shutil
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import takewhile
from pathlib import Path

from filelock import FileLock, Timeout

from skystack.errors import InputError, exists
from skystack.io.files import TEMPORARY_SUFFIX, make_folder, not_written

LOCK = ".lock"
"""The lock file of a run folder. The file stays; the lock ends with the process."""
_LOCK_TIMEOUT_S, _RETRY_S = 0.1, 0.02
"""A failing process deletes its lock file, so acquiring a lock is retried briefly."""


@contextmanager
def locked_folder(folder: Path, below: Iterable[str] = ()) -> Iterator[None]:
    """Lock a run folder, which is created if it does not exist.

    The operating system releases the lock when the process ends, however it ends. Temporary files
    and folders that killed processes left in the folder are deleted, as are those in the subfolders
    `below` (glob patterns) of the same run. On failure, a folder that holds only the lock is
    deleted. Raises InputError if another process holds the lock.
    """
    with delete_empty_on_failure(folder):
        lock = _acquire(folder)
        try:
            for each in (folder, *(inner for pattern in below for inner in folder.glob(pattern))):
                for leftover in each.glob(f".*{TEMPORARY_SUFFIX}"):
                    if leftover.is_dir():
                        shutil.rmtree(leftover, ignore_errors=True)
                    else:
                        leftover.unlink(missing_ok=True)
            yield
        except BaseException:
            if not any(path.is_file() for path in folder.rglob("*") if path != folder / LOCK):
                (folder / LOCK).unlink(missing_ok=True)  # while the lock is held
            raise
        finally:
            lock.release()


@contextmanager
def delete_empty_on_failure(folder: Path) -> Iterator[None]:
    """On failure inside the context, delete folders that were created in it and contain no file.

    A folder that another process has locked is left alone, with everything in it.
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
            stack.callback(_acquire(folder).release)
        for inner in folder.iterdir():
            if inner.is_dir() and not inner.is_symlink():
                _delete_empty(inner)
        folder.rmdir()  # raises OSError if it is not empty


def check_unlocked(folder: Path) -> None:
    """Raise InputError if another process has locked a folder."""
    if exists(folder / LOCK):
        _acquire(folder).release()


def is_abandoned(folder: Path, idle_s: float) -> bool:
    """Whether a folder has been idle for a while and no process holds its lock."""
    if time.time() - folder.stat().st_mtime <= idle_s:
        return False
    try:
        _acquire(folder).release()
    except InputError:
        return False
    return True


def is_scratch(path: Path) -> bool:
    """Whether a file in a run folder is a lock, or a temporary file of a killed process."""
    return path.name == LOCK or path.suffix == TEMPORARY_SUFFIX


def _acquire(folder: Path) -> FileLock:
    """Acquire the lock of a folder. Raises InputError if another process holds it."""
    lock = FileLock(folder / LOCK, timeout=_LOCK_TIMEOUT_S, thread_local=False)
    while True:
        make_folder(folder)
        try:
            with warnings.catch_warnings():
                # Without `flock` in the file system, filelock falls back to a marker file.
                warnings.simplefilter("ignore", UserWarning)
                lock.acquire(poll_interval=_RETRY_S)
        except FileNotFoundError:
            continue  # another process failed and deleted the empty folder
        except Timeout:
            raise InputError(
                f"{folder}: is in use by another process (allowed: another folder with --out, or "
                "wait until it ends)"
            ) from None
        except OSError as error:
            raise not_written(folder / LOCK, error) from None
        return lock
