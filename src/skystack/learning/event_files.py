"""TensorBoard event files with the contents of `metrics.jsonl` (extra `[tensorboard]`).

A resumed training run first truncates `metrics.jsonl` to its checkpoint. Each run rewrites the
event files from all lines of `metrics.jsonl`, so every step appears exactly once.
"""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from skystack.errors import missing_extra
from skystack.io.files import make_folder

FOLDER = "tensorboard"
"""The name of the folder inside the run folder."""
WHEN = ("update", "steps", "wall_s")
"""The fields of a line that give its time. All others become scalars of the same name."""


def event_files(run: Path) -> AbstractContextManager[Callable[[], None]]:
    """A context in which each call writes the new lines of the run's `metrics.jsonl`.

    The remaining lines are written when the context ends without an exception. Raises InputError
    immediately if the extra is missing, and on entry if the folder is not writable.
    """
    return _event_files(run, _tensorboard())


@contextmanager
def _event_files(run: Path, tensorboard: Any) -> Iterator[Callable[[], None]]:
    folder = make_folder(run / FOLDER)
    writers: list[_Scalars] = []

    def write_new() -> None:
        if not writers:  # opened late, because training truncates the metrics first
            writers.append(_Scalars(run / "metrics.jsonl", folder, tensorboard))
        writers[0].write_new()

    try:
        yield write_new
        write_new()
    finally:
        for scalars in writers:
            scalars.close()


def _tensorboard() -> Any:
    try:
        import tensorboardX  # noqa: PLC0415
    except ImportError:
        raise missing_extra("--tensorboard", "tensorboardX", "tensorboard") from None
    return tensorboardX


class _Scalars:
    """Writes the lines of `metrics.jsonl`, from the first, to a new event file."""

    def __init__(self, metrics: Path, folder: Path, tensorboard: Any) -> None:
        for old in folder.glob("events.out.tfevents.*"):
            old.unlink()
        self._metrics = metrics.open(encoding="utf-8")
        # purge_step makes a running TensorBoard discard the values of the old file.
        self._writer = tensorboard.SummaryWriter(str(folder), purge_step=0, flush_secs=10)

    def write_new(self) -> None:
        lines = [json.loads(line) for line in self._metrics]
        for line in lines:
            # The last line is from now. Earlier ones are placed by training time without breaks.
            self._add(line, time.time() - (lines[-1]["wall_s"] - line["wall_s"]))

    def _add(self, line: dict[str, Any], at_s: float) -> None:
        for name, value in line.items():
            if name not in WHEN and value is not None:
                self._writer.add_scalar(name, value, line["steps"], walltime=at_s)

    def close(self) -> None:
        self._metrics.close()
        self._writer.close()
