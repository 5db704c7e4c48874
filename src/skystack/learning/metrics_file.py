"""`metrics.jsonl`: a line an update, and never another update than the checkpoint goes on from."""

import json
import os
import time
from pathlib import Path
from typing import Any

from skystack.errors import CheckpointError
from skystack.io.files import append_line, atomic_write


class MetricsFile:
    """The lines of a training, cut back to those of the updates already made.

    A line is written before its update is saved: whatever kills the training, a checkpoint has all
    its lines, and those beyond it, whole or half, are cut off when it is gone on with.
    """

    def __init__(self, path: Path, updates: int, begun: float) -> None:
        """Raises CheckpointError when the lines of those updates are not there."""
        lines = _lines(path, updates) if updates else []
        atomic_write(path, "".join(lines).encode())
        # As if the updates made before had been made just before this run.
        self._begun: float = begun - (json.loads(lines[-1])["wall_s"] if lines else 0.0)
        self._path, self._file = path, os.open(path, os.O_WRONLY | os.O_APPEND)

    def wall_s(self) -> float:
        """What all has taken until now, earlier runs included as far as their lines tell."""
        return time.monotonic() - self._begun

    def append(self, line: dict[str, Any], values: dict[str, float | None]) -> None:
        """Raises InputError when the line cannot be written."""
        text = json.dumps(line | {"wall_s": self.wall_s()} | values)
        append_line(self._file, self._path, text)

    def sync(self) -> None:
        """Returns when all lines are on the disk: before a checkpoint that needs them is."""
        os.fsync(self._file)

    def close(self) -> None:
        os.close(self._file)


def _lines(path: Path, updates: int) -> list[str]:
    """The lines of the first updates."""
    try:
        lines = path.read_text().splitlines(keepends=True)[:updates]
        if [json.loads(line)["update"] for line in lines] == list(range(1, updates + 1)):
            return lines
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise CheckpointError(
        f"{path}: does not hold the {updates} updates of the checkpoint; "
        "train into another folder, or without --resume"
    )
