"""Files are read up to a size, and written aside and renamed: nothing half-written is found."""

import os
import tempfile
from pathlib import Path

from skystack.errors import InputError

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
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"cannot be read ({reason})") from None
    if len(data) > most_bytes:
        raise InputError(f"is too large (allowed: {most_bytes // 1_000_000} MB)")
    return data


def write_aside(path: Path, data: bytes) -> None:
    """Write a whole file or none. Raises InputError when it cannot be written."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    aside = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        aside.chmod(0o644)
        aside.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        aside.unlink(missing_ok=True)


def make_folder(path: Path) -> Path:
    """Create a folder for output, and its parents. Raises InputError when that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a folder: {error.strerror}") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder cannot be written to")
    return path
