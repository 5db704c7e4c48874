"""`metrics.jsonl`: one line per update, kept consistent with the checkpoint."""

import json
import os
import time
from pathlib import Path
from typing import Any

from skystack.errors import CheckpointError
from skystack.io.files import append_line, atomic_write


class MetricsFile:
    """The lines of a training run, truncated on opening to the updates of the checkpoint.

    A line is written before its update is saved. So a checkpoint always has all its lines, even if
    the process is killed; complete or partial lines after it are removed on resume.
    """

    def __init__(self, path: Path, updates: int, started: float) -> None:
        """Open the file. `updates` is the number of updates of the checkpoint.

        `started` is the start of the run by `time.monotonic`. Raises CheckpointError if a line of
        the first `updates` updates is missing.
        """
        lines = _lines(path, updates) if updates else []
        atomic_write(path, "".join(lines).encode())
        # Count the time of earlier runs, without the breaks between them.
        self._started: float = started - (json.loads(lines[-1])["wall_s"] if lines else 0.0)
        self._path, self._file = path, os.open(path, os.O_WRONLY | os.O_APPEND)

    def wall_s(self) -> float:
        """The training time so far, including earlier runs up to their last remaining line."""
        return time.monotonic() - self._started

    def append(self, line: dict[str, Any], values: dict[str, float | None]) -> None:
        """Append a line. Raises InputError if it cannot be written."""
        text = json.dumps(line | {"wall_s": self.wall_s()} | values)
        append_line(self._file, self._path, text)

    def sync(self) -> None:
        """Flush all lines to disk. Call this before a checkpoint that needs them is saved."""
        os.fsync(self._file)

    def close(self) -> None:
        os.close(self._file)


def _lines(path: Path, updates: int) -> list[str]:
    """The lines of the first `updates` updates. Raises CheckpointError if one is missing."""
    try:
        lines = path.read_text().splitlines(keepends=True)[:updates]
        if [json.loads(line)["update"] for line in lines] == list(range(1, updates + 1)):
            return lines
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise CheckpointError(
        f"{path}: does not contain the {updates} updates of the checkpoint "
        "(allowed: another folder with --out, or this one after its files are deleted)"
    )
