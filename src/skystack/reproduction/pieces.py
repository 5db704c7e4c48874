"""Pieces of work that are done once: each leaves a record beside its files.

A record says what the piece was made from (its key), what came of it, and the hashes of its files.
A piece whose record has the same key and whose files are unchanged is not made again.
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
    """What came of a piece; None when it is not there, was made from something else, or damaged."""
    try:
        kept: _Record = decode(read_whole(record), _Record, str(record))
        # Hash the caller's list of files: names in the record may point anywhere.
        hashes = {name: _hash(record.parent / name) for name in files}
    except (InputError, OSError):
        return None
    return kept.result if (kept.key, kept.files) == (key, hashes) else None


def once(
    record: Path, key: Key, make: Callable[[], Any], files: Iterable[str] = ()
) -> tuple[Any, bool]:
    """What comes of a piece, made now unless it was made before; and whether it was.

    `files` are what it writes, beside the record. While it is made there is no record.
    """
    files = tuple(files)
    known = finished(record, key, files)
    if known is not None:
        return known, True
    record.unlink(missing_ok=True)
    result = make()
    hashes = {name: _hash(record.parent / name) for name in files}
    kept = {"key": key, "result": result, "files": hashes}
    atomic_write(record, (json.dumps(kept, indent=1) + "\n").encode())
    return result, False


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
