"""Read files up to a size limit; write them through a temporary file and a rename."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha256
from os import PathLike
from pathlib import Path
from secrets import token_hex
from typing import IO

from skystack.errors import InputError, exists
from skystack.io.signals import defer_signals

AnyPath = str | PathLike[str]
TEMPORARY_SUFFIX = ".aside"
MOST_BYTES = 64_000_000


def read_whole(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Read a whole file. Raises InputError if it is not a file, is unreadable or is too large."""
    try:
        if exists(path) and not (path.is_file() or path.is_dir()):
            # Reading a pipe could block forever.
            raise InputError("cannot be read (it is not a regular file)")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise InputError(f"cannot be read ({_reason(error)})") from None
    if len(data) > most_bytes:
        raise InputError(f"is too large (allowed: {most_bytes // 1_000_000} MB)")
    return data


def file_digest(path: Path) -> str:
    """The SHA-256 digest of a file. Raises InputError as `read_whole` does."""
    return sha256(read_whole(path)).hexdigest()


def atomic_write(path: Path, data: bytes) -> None:
    """Write a file atomically and sync it to disk: a power cut leaves the old file or the new one.

    Raises InputError if it cannot be written.
    """
    with defer_signals(), atomic_files([path]) as [file], writing(path):
        file.write(data)


@contextmanager
def atomic_files(paths: Sequence[Path], outdated: Sequence[Path] = ()) -> Iterator[list[IO[bytes]]]:
    """Open temporary files that together replace the files at `paths` when the context ends.

    They are synced to disk first, then `outdated` files are deleted. If the body raises, or the
    disk is full, all old files stay. Raises InputError for a file that cannot be written.
    """
    for path in outdated:
        check_not_folder(path)
    with ExitStack() as stack:
        files = [stack.enter_context(_open_temporary(path)) for path in paths]
        yield files
        with defer_signals():
            for path, file in zip(paths, files, strict=True):
                with writing(path):
                    file.flush()
                    os.fsync(file.fileno())
            for path in outdated:
                with writing(path):
                    path.unlink(missing_ok=True)
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
        with defer_signals(), writing(path):
            file = _temporary_path(path).open("xb")
        yield file
    finally:
        if file is not None:
            with defer_signals():
                with suppress(OSError):  # a full disk was reported earlier
                    file.close()
                Path(file.name).unlink(missing_ok=True)


def _temporary_path(path: Path) -> Path:
    """A random name in the same folder, short even if the file's name is long."""
    return path.with_name(f".{path.name[:40]}.{token_hex(8)}{TEMPORARY_SUFFIX}")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Convert an OSError inside the context to an InputError: the file cannot be written."""
    try:
        yield
    except OSError as error:
        raise not_written(path, error) from None


def append_line(file: int, path: Path, line: str) -> None:
    """Append a line to an open file, unbuffered. Raises InputError if it cannot be written."""
    data = line.encode() + b"\n"
    try:
        while data:  # a disk that fills up accepts a part first, then raises
            data = data[os.write(file, data) :]
    except OSError as error:
        raise not_written(path, error) from None


def check_output(output: Path, *sources: Path) -> None:
    """Check an output path before the work starts.

    Raises InputError if its folder does not exist (`-o` does not create it), or if it is a folder
    or one of `sources`.
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
    """Create an output folder and its parents. Raises InputError if it cannot be written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise InputError(f"{path}: the folder cannot be created: {_reason(error)}") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder cannot be written to")
    return path


@contextmanager
def scratch_folder(prefix: str, within: Path | None = None, suffix: str = "") -> Iterator[Path]:
    """A temporary folder, deleted afterwards; in the system's temporary folder by default.

    Raises InputError if it cannot be made in the folder `within`.
    """
    folder: tempfile.TemporaryDirectory[str] | None = None
    try:
        with defer_signals():
            try:
                folder = tempfile.TemporaryDirectory(
                    suffix, prefix, within, ignore_cleanup_errors=True
                )
            except OSError as error:
                if within is None:
                    raise
                raise not_written(within, error) from None
        yield Path(folder.name)
    finally:
        with defer_signals():
            if folder is not None:
                folder.cleanup()


def publish(folder: Path, target: Path) -> None:
    """Move all files of a folder to the same places in another one of the same file system.

    Raises InputError, and moves nothing, if a folder is where a file belongs.
    """
    files = [path for path in folder.rglob("*") if path.is_file()]
    places = [target / path.relative_to(folder) for path in files]
    for place in places:
        if place.is_dir():
            raise InputError(f"{place}: is a folder (allowed: a file)")
    with defer_signals():
        for path, place in zip(files, places, strict=True):
            make_folder(place.parent)
            path.replace(place)


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # not supported everywhere; the file itself is synced
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
