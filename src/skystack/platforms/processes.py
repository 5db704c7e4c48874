"""Work of other simulators in separate processes, with a time limit; crashed ones are replaced."""

import multiprocessing
import os
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as OutOfTime
from concurrent.futures.process import BrokenProcessPool
from itertools import repeat
from multiprocessing.process import BaseProcess
from numbers import Real
from pathlib import Path
from threading import Timer
from typing import Any, NamedTuple, TypeVar

from skystack.compilation.cores import cores
from skystack.errors import InputError, PlatformError, requires_extra
from skystack.io.signals import starting_processes, wait_for

TIME_LIMIT_S = 120.0
"""The default time limit for an item."""
MAX_TIME_LIMIT_S = 10_000_000
"""The longest time limit; much longer ones overflow timers."""
START_LIMIT_S = 1200.0
"""The time limit for a process to start: imports, the simulator, and compilation, which takes
minutes on a busy machine."""

Item = TypeVar("Item")
Result = TypeVar("Result")
Make = Callable[[Path], Callable[[Item], Result]]
"""Called once in each process with the process's own folder; returns the function for its items."""


class ItemResult(NamedTuple):
    """The result of an item, or the reason why it failed."""

    result: Any
    failed: str | None = None


_DIED_STARTING = ItemResult(None, "its process died, or took too long, while starting")
AHEAD = 8
"""Items per process that are scheduled before their results are requested."""


def in_processes(
    make: Make[Item, Result], items: Sequence[Item], folder: Path, time_limit_s: float
) -> Generator[ItemResult, None, None]:
    """The results of all items in order, from one process per core.

    `make` and the items must be picklable. An item fails if it exceeds the time limit, raises
    PlatformError or its process dies; the other items are not affected. Raises InputError for a
    time limit out of range, and as soon as an item raises it.
    """
    checked_time_limit(time_limit_s)
    with requires_extra("another platform", "bluebird] or [bluesky"):
        from pebble import ProcessPool  # noqa: PLC0415

    ahead, others = AHEAD * len(cores()), multiprocessing.active_children()
    with ProcessPool(
        max_workers=min(len(cores()), len(items)),
        initializer=_begin,
        initargs=(make, folder),
        context=multiprocessing.get_context("spawn"),
    ) as pool:
        try:
            futures = deque(_scheduled(pool, items[:ahead], time_limit_s))
            for index in range(len(items)):
                outcome = _outcome(futures.popleft(), time_limit_s)
                yield outcome
                if outcome is _DIED_STARTING:
                    yield from repeat(_DIED_STARTING, len(items) - index - 1)
                    return
                # Finished results that are not yet consumed take memory, so they are limited.
                futures += _scheduled(pool, items[index + ahead :][:1], time_limit_s)
        finally:
            pool.stop()
            _terminate_workers(others)


def _terminate_workers(others: Sequence[BaseProcess]) -> None:
    """Call this before pebble deletes its locks: starting workers would print a traceback."""
    for child in multiprocessing.active_children():
        if child not in others and child.name.startswith("pebble"):
            child.terminate()


def checked_time_limit(time_limit_s: Any) -> float:
    """The limit as a float. Raises InputError unless it is above 0 and at most MAX_TIME_LIMIT_S."""
    number = isinstance(time_limit_s, Real) and not isinstance(time_limit_s, bool)
    if not (number and 0.0 < time_limit_s <= MAX_TIME_LIMIT_S):
        raise InputError(
            f"time_limit_s is {time_limit_s!r} "
            f"(allowed: seconds above 0, up to {MAX_TIME_LIMIT_S:,})"
        )
    return float(time_limit_s)


def _scheduled(pool: Any, items: Sequence[Item], time_limit_s: float) -> list[Future[Any]]:
    try:
        with starting_processes():
            return [pool.schedule(_work, args=(item,), timeout=time_limit_s) for item in items]
    except RuntimeError:  # a pool whose processes failed to start accepts no more items
        broken = Future[Any]()
        broken.set_exception(BrokenProcessPool())
        return [broken] * len(items)


def _outcome(future: Future[Any], time_limit_s: float) -> ItemResult:
    from pebble import ProcessExpired  # noqa: PLC0415

    try:
        return ItemResult(wait_for(future))
    except OutOfTime:
        return ItemResult(None, f"took more than {time_limit_s:.0f} s")
    except ProcessExpired as expired:
        return ItemResult(None, f"the simulator's process died (exit code {expired.exitcode})")
    except PlatformError as error:
        return ItemResult(None, str(error))
    except (BrokenProcessPool, CancelledError):
        return _DIED_STARTING


_worker: Callable[[Any], Any] | Exception | None = None
"""The function for this process's items, or the error that occurred while starting."""


def _begin(make: Make[Any, Any], folder: Path) -> None:
    """Initialise a new process. An error is kept, and raised for its items."""
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
        raise _worker or PlatformError("its process was not initialised")
    return _worker(item)
