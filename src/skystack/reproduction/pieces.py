"""Caching of pieces of work: each finished piece leaves a record next to its files.

A record holds the key (everything that the piece depends on), the result, and the hashes of the
files. A piece is not repeated if its record has the same key and its files are unchanged.
"""

import hashlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec

from skystack.errors import InputError
from skystack.io.files import atomic_write, read_whole
from skystack.io.json_file import decode

Key = dict[str, Any]
"""Everything that the result depends on, as JSON."""


class _Record(msgspec.Struct):
    key: Any
    result: Any
    files: dict[str, str]


def finished(record: Path, key: Key, files: Iterable[str] = ()) -> Any | None:
    """The result of a finished piece; None if it is missing or damaged, or its key differs."""
    try:
        stored: _Record = decode(read_whole(record), _Record, str(record))
        # Only the caller's files are hashed: names in the record could point anywhere.
        hashes = {name: _hash(record.parent / name) for name in files}
    except (InputError, OSError):
        return None
    return stored.result if (stored.key, stored.files) == (key, hashes) else None


def once(
    record: Path, key: Key, make: Callable[[], Any], files: Iterable[str] = ()
) -> tuple[Any, bool]:
    """The result of a piece, which `make` computes unless it is cached; and whether it was cached.

    `files` are the names of the files that `make` writes next to the record. While `make` runs,
    there is no record.
    """
    files = tuple(files)
    cached = finished(record, key, files)
    if cached is not None:
        return cached, True
    record.unlink(missing_ok=True)
    result = make()
    hashes = {name: _hash(record.parent / name) for name in files}
    contents = {"key": key, "result": result, "files": hashes}
    atomic_write(record, (json.dumps(contents, indent=1) + "\n").encode())
    return result, False


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
