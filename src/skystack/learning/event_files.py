"""The curves of a training for TensorBoard (extra `[tensorboard]`): `metrics.jsonl` told again.

The event files follow `metrics.jsonl`, which training cuts back to its checkpoint before it goes
on: made anew from all of its lines each time, they hold every step once whatever happened before.
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
"""Inside the run folder."""
WHEN = ("update", "steps", "wall_s")
"""Fields of a line that say when it was; all others are scalars, named as they are."""


def event_files(run: Path) -> AbstractContextManager[Callable[[], None]]:
    """Within it, each call writes what has come to the run's `metrics.jsonl`; so does a good end.

    Raises InputError at once when the extra is missing, and when it is entered if the folder
    cannot be written to.
    """
    return _event_files(run, _tensorboard())


@contextmanager
def _event_files(run: Path, tensorboard: Any) -> Iterator[Callable[[], None]]:
    folder = make_folder(run / FOLDER)
    opened: list[_Scalars] = []

    def follow() -> None:
        if not opened:  # only now: training has cut the metrics back
            opened.append(_Scalars(run / "metrics.jsonl", folder, tensorboard))
        opened[0].follow()

    try:
        yield follow
        follow()
    finally:
        for scalars in opened:
            scalars.close()


def _tensorboard() -> Any:
    try:
        import tensorboardX  # noqa: PLC0415
    except ImportError:
        raise missing_extra("--tensorboard", "tensorboardX", "tensorboard") from None
    return tensorboardX


class _Scalars:
    """The lines of `metrics.jsonl` from the first on, in an event file of their own."""

    def __init__(self, metrics: Path, folder: Path, tensorboard: Any) -> None:
        for old in folder.glob("events.out.tfevents.*"):
            old.unlink()
        self._metrics = metrics.open(encoding="utf-8")
        # A TensorBoard that shows the old file forgets what it has read there.
        self._writer = tensorboard.SummaryWriter(str(folder), purge_step=0, flush_secs=10)

    def follow(self) -> None:
        lines = [json.loads(line) for line in self._metrics]
        for line in lines:
            # The last is of now; those before it by what all has taken without interruptions.
            self._add(line, time.time() - (lines[-1]["wall_s"] - line["wall_s"]))

    def _add(self, line: dict[str, Any], at_s: float) -> None:
        for name, value in line.items():
            if name not in WHEN and value is not None:
                self._writer.add_scalar(name, value, line["steps"], walltime=at_s)

    def close(self) -> None:
        self._metrics.close()
        self._writer.close()
