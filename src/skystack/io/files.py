"""Reading files up to a size limit, and writing them through a temporary file and a rename."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from os import PathLike
from pathlib import Path
from secrets import token_hex
from typing import IO

from skystack.errors import InputError, exists
from skystack.io.signals import held

AnyPath = str | PathLike[str]
TEMPORARY_SUFFIX = ".aside"
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


def atomic_write(path: Path, data: bytes) -> None:
    """Write a whole file or none, on the disk when this returns: a power cut leaves the old one.

    Raises InputError when it cannot be written.
    """
    with held(), atomic_files([path]) as [file], writing(path):
        file.write(data)


@contextmanager
def atomic_files(paths: Sequence[Path]) -> Iterator[list[IO[bytes]]]:
    """Open temporary files that replace others, all together, when the context ends.

    They are synced to disk first. If anything is raised inside, the old files stay. Raises
    InputError for a file that cannot be written.
    """
    with ExitStack() as stack:
        files = [stack.enter_context(_open_temporary(path)) for path in paths]
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
def _open_temporary(path: Path) -> Iterator[IO[bytes]]:
    if "\0" in str(path):
        raise not_written(path, ValueError("a null byte in the name"))
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
    return path.with_name(f".{path.name[:40]}.{token_hex(8)}{TEMPORARY_SUFFIX}")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn system errors inside the context into InputError: the file cannot be written."""
    try:
        yield
    except OSError as error:
        raise not_written(path, error) from None


def append_line(file: int, path: Path, line: str) -> None:
    """Write a line at the end of an open file, at once. Raises InputError when it cannot be."""
    data = line.encode() + b"\n"
    try:
        while data:  # a disk that fills up takes a part first, then says why not the rest
            data = data[os.write(file, data) :]
    except OSError as error:
        raise not_written(path, error) from None


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


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # not every system can; the file itself is safe
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def not_written(path: Path, error: OSError | ValueError) -> InputError:
    """The error for a file that cannot be written."""
    return InputError(f"{path}: cannot be written: {_reason(error)}")


def _reason(error: OSError | ValueError) -> str | None:
    return error.strerror if isinstance(error, OSError) else str(error)
