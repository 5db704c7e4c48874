"""Work of other simulators in processes of their own: one each, a time limit, deaths survived."""

import multiprocessing
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as OutOfTime
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from threading import Timer
from typing import Any, NamedTuple, TypeVar

from skystack.cores import cores
from skystack.errors import InputError, PlatformError, of_extra
from skystack.signals import starting_processes, wait_for

TIME_LIMIT_S = 120.0
"""For an item, unless told otherwise."""
START_LIMIT_S = 180.0
"""For a process to begin: imports, the simulator's own start, compilation."""
_DIED_STARTING = "its process died, or took too long, while starting"

Item = TypeVar("Item")
Result = TypeVar("Result")
Make = Callable[[Path], Callable[[Item], Result]]
"""Makes, in each process once and given a folder of its own, the function that does the work."""


class Done(NamedTuple):
    """What came of some items, by their index."""

    results: dict[int, Any]
    failed: dict[int, str]


def in_processes(
    make: Make[Item, Result],
    items: Sequence[Item],
    folder: Path,
    time_limit_s: float,
    on_done: Callable[[int], None] = lambda done: None,
) -> Done:
    """Do every item in one process a core; `make` and the items must be picklable.

    An item that takes longer than its time limit, raises PlatformError, or whose process dies, has
    failed; the others are done. Raises InputError as soon as an item does.
    """
    with of_extra("another platform", "bluebird] or [bluesky"):
        from pebble import ProcessPool  # noqa: PLC0415

    done = Done({}, {})
    with ProcessPool(
        max_workers=min(len(cores()), len(items)),
        initializer=_begin,
        initargs=(make, folder),
        context=multiprocessing.get_context("spawn"),
    ) as pool:
        try:
            with starting_processes():
                futures = [
                    pool.schedule(_work, args=(item,), timeout=time_limit_s) for item in items
                ]
            for index, future in enumerate(futures):
                try:
                    _wait_for(future, index, time_limit_s, done)
                except (BrokenProcessPool, CancelledError):
                    done.failed.update(dict.fromkeys(range(index, len(items)), _DIED_STARTING))
                    break
                on_done(index + 1)
        finally:
            pool.stop()
    return done


def _wait_for(future: Any, index: int, time_limit_s: float, done: Done) -> None:
    from pebble import ProcessExpired  # noqa: PLC0415

    try:
        done.results[index] = wait_for(future)
    except OutOfTime:
        done.failed[index] = f"took more than {time_limit_s:.0f} s"
    except ProcessExpired as expired:
        done.failed[index] = f"the simulator's process died (exit code {expired.exitcode})"
    except PlatformError as error:
        done.failed[index] = str(error)


_worker: Callable[[Any], Any] | Exception | None = None
"""What this process does, or why it cannot."""


def _begin(make: Make[Any, Any], folder: Path) -> None:
    """In a new process. Errors are kept for when there is somebody to tell."""
    global _worker  # noqa: PLW0603  (a process has one simulator)
    limit = Timer(START_LIMIT_S, os._exit, args=(1,))
    limit.daemon = True
    limit.start()
    try:
        _worker = make(Path(tempfile.mkdtemp(dir=folder)))
    except (InputError, PlatformError) as error:
        _worker = error
    except Exception as error:
        text = " ".join(str(error).split())
        _worker = PlatformError(f"did not start: {type(error).__name__}: {text}")
    finally:
        limit.cancel()


def _work(item: Any) -> Any:
    if isinstance(_worker, Exception) or _worker is None:
        raise _worker or PlatformError("its process was not begun")
    return _worker(item)
