"""The journal of a session: all that happens in it, written as it happens.

A session that was killed is restored by flying its journal again. The file has one JSON object per
line: a header, then entries. It is read as untrusted: unknown fields, and values out of range, are
refused.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Annotated, Any

import msgspec

import skystack
from skystack.errors import InputError, exists
from skystack.io.files import read_whole, writing
from skystack.io.locks import locked_folder
from skystack.live.advice_log import AdviceAnswered, AdviceShown

FORMAT = 2
FOLDER, FILE = "journal", "session.jsonl"
"""In the folder of a session."""
MOST_CYCLES = 100_000
_Name = Annotated[str, msgspec.Meta(max_length=100)]
_Count = Annotated[int, msgspec.Meta(ge=0, le=MOST_CYCLES)]


class Header(msgspec.Struct, tag="session", forbid_unknown_fields=True, frozen=True):
    """What the session is of. A journal continues only a session with the same header."""

    traffic: Annotated[str, msgspec.Meta(max_length=300)]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    sector: str
    """The digest of the sector."""
    start: str
    """The digest of the traffic at the start."""
    performance: _Name
    platform: _Name
    version: _Name = skystack.__version__
    format: int = FORMAT


class CycleFlown(msgspec.Struct, tag="cycle", forbid_unknown_fields=True, frozen=True):
    """A cycle was flown."""

    number: _Count


class ClearanceIssued(msgspec.Struct, tag="clearance", forbid_unknown_fields=True, frozen=True):
    """A transmission was issued before the next cycle."""

    callsign: _Name
    by: _Name
    heading_deg: Annotated[int, msgspec.Meta(ge=0, lt=360)] | None = None
    turn: Annotated[str, msgspec.Meta(pattern="^(left|right)$")] | None = None
    fix: Annotated[int, msgspec.Meta(ge=0, le=1000)] | None = None
    level_ticks: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] | None = None
    instructions: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 1


class HandedOver(msgspec.Struct, tag="hand-over", forbid_unknown_fields=True, frozen=True):
    """Flights were handed over to the adviser or taken back; no callsigns means all."""

    callsigns: Annotated[list[_Name], msgspec.Meta(max_length=1000)]
    to_adviser: bool


class WentBack(msgspec.Struct, tag="rewind", forbid_unknown_fields=True, frozen=True):
    """The session went back to the end of a cycle."""

    cycle: _Count


Entry = CycleFlown | ClearanceIssued | HandedOver | WentBack | AdviceShown | AdviceAnswered


class Journal:
    """An open journal. Every entry is written at once."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._path, self._file = path, file

    def add(self, entry: Header | Entry) -> None:
        """Append an entry. Raises InputError if it cannot be written."""
        with writing(self._path):
            self._file.write(msgspec.json.encode(entry) + b"\n")
            self._file.flush()


@contextmanager
def open_journal(
    session: Path, header: Header, fresh: bool = False
) -> Iterator[tuple[Journal, list[Entry]]]:
    """The journal in a session's folder, and its entries so far.

    They are empty if there is no journal, or with `fresh`. Raises InputError for a journal of
    another session, for a damaged one, and if another process uses it.
    """
    folder = session / FOLDER
    path = folder / FILE
    with locked_folder(folder):
        entries, length = ([], 0) if fresh else _entries(path, header)
        with writing(path):
            file = path.open("r+b" if length else "wb")
        with file:
            file.truncate(length)
            file.seek(length)
            journal = Journal(path, file)
            if not length:
                journal.add(header)
            yield journal, entries


def _entries(path: Path, header: Header) -> tuple[list[Entry], int]:
    """The entries of a journal and the length in bytes of its intact lines.

    Raises InputError if it has another header.
    """
    if not exists(path):
        return [], 0
    lines = read_whole(path).splitlines(keepends=True)
    if lines and not lines[-1].endswith(b"\n"):
        del lines[-1]  # the process was killed while it wrote
    if not lines:
        return [], 0
    if _decoded(path, 1, lines[0], Header) != header:
        raise InputError(
            f"{path} belongs to a session with other flights, another sector or performance model, "
            "or another version of skystack (allowed: --new to replace it, or another --out)"
        )
    entries = [_decoded(path, number, line, Entry) for number, line in enumerate(lines[1:], 2)]
    return entries, sum(map(len, lines))


def _decoded(path: Path, number: int, line: bytes, kind: Any) -> Any:
    try:
        return msgspec.json.decode(line, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}, line {number}: {error} (allowed: a journal written by skystack session; "
            "--new begins another session)"
        ) from None
