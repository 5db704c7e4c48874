"""Run items in worker processes, one per core, that report their progress.

If a worker dies, or reports nothing for too long, only its current item fails; a new worker runs
the others. (`skystack.platforms.processes` has limits for whole items, and needs an extra.)
"""

import multiprocessing
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple

from skystack.compilation.cores import cores
from skystack.compilation.programs import compile_for_cores, program_cache
from skystack.errors import InputError, PlatformError
from skystack.io.parents import end_with_parent
from skystack.io.signals import POLL_S, check, starting_processes

START_LIMIT_S = 1200.0
"""The limit for a worker to start and for the first report of an item: both may compile programs,
which takes minutes on a busy machine."""
END_LIMIT_S = 30.0
"""The time that a worker gets to store its compiled programs."""

Report = Callable[[str], None]
"""Called by the work on an item with what it does next, such as `cycle 12`."""
Make = Callable[[], Callable[[Any, Report], Any]]
"""Called once in each worker; returns the function that runs an item."""


class Finished(NamedTuple):
    """The result of an item, or why it failed."""

    item: Any
    result: Any = None
    failed: str | None = None


class _Worker:
    """A process and what the parent knows of it."""

    def __init__(self, make: Make, core: int | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(theirs, make, core))
        self.core, self.item = core, None
        self.doing: str | None = None
        with starting_processes():
            self.process.start()
        theirs.close()

    def give(self, item: Any) -> None:
        self.item, self.doing, self.heard_s = item, None, time.monotonic()
        self.connection.send(item)

    def report(self, doing: str) -> None:
        self.doing, self.heard_s = doing, time.monotonic()

    def overdue(self, limit_s: float) -> bool:
        limit = START_LIMIT_S if self.doing is None else limit_s
        return time.monotonic() - self.heard_s > limit

    def where(self, what: str) -> str:
        return what if self.doing is None else f"{self.doing}: {what}"

    def end(self) -> None:
        """Let the process end."""
        self.connection.close()
        self.process.join(END_LIMIT_S)
        self.kill()

    def kill(self) -> None:
        """End the process, and all processes that it has started."""
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        if hasattr(os, "killpg") and self.process.pid is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)


def run_in_workers(
    make: Make,
    items: Sequence[Any],
    limit_s: float,
    on_report: Callable[[Any, str], None] = lambda item, doing: None,
    process_per_item: bool = False,
) -> Iterator[Finished]:
    """The results of all items, in the order in which they are finished.

    `make` and the items must be picklable. An item fails if it raises InputError or PlatformError,
    if its process dies, or if it reports nothing for `limit_s` seconds; all others are finished.
    `on_report` is called with each report of an item. With `process_per_item`, every
    item has its own process.
    """
    left, workers = deque(items), list[_Worker]()

    def start(core: int | None) -> None:
        workers.append(_Worker(make, core))
        workers[-1].give(left.popleft())

    try:
        for core in cores()[: len(items)]:
            start(core)
        while workers:
            check()
            ready = wait([each.connection for each in workers], timeout=POLL_S)
            for worker in list(workers):
                finished = _news(worker, worker.connection in ready, limit_s, on_report)
                if finished is None:
                    continue
                if left and not process_per_item and worker.process.is_alive():
                    worker.give(left.popleft())
                else:
                    workers.remove(worker)
                    worker.end()
                    if left:
                        start(worker.core)
                yield finished
    finally:
        for worker in workers:
            worker.kill()


def _news(
    worker: _Worker, ready: bool, limit_s: float, on_report: Callable[[Any, str], None]
) -> Finished | None:
    """The result of a worker's item if it is finished; if it is overdue, the worker is killed."""
    if ready:
        return _received(worker, on_report)
    if not worker.overdue(limit_s):
        return None
    worker.kill()
    took_s = START_LIMIT_S if worker.doing is None else limit_s
    return Finished(worker.item, failed=worker.where(f"took longer than {took_s:g} s"))


def _received(worker: _Worker, on_report: Callable[[Any, str], None]) -> Finished | None:
    """Handle one message of a worker; the result if its item is finished."""
    try:
        kind, value = worker.connection.recv()
    except (EOFError, OSError):
        worker.process.join()
        text = f"its process died (exit code {worker.process.exitcode})"
        return Finished(worker.item, failed=worker.where(text))
    if kind == "report":
        worker.report(value)
        on_report(worker.item, value)
        return None
    if kind == "failed":
        return Finished(worker.item, failed=value)
    return Finished(worker.item, value)


def _serve(connection: Connection, make: Make, core: int | None) -> None:
    """Run items in a worker until the connection is closed."""
    if hasattr(os, "setsid"):
        os.setsid()  # so that the parent can also end the processes that the work has started
    end_with_parent()
    if core is not None:
        os.sched_setaffinity(0, {core})
    os.dup2(2, 1)  # standard output belongs to the command
    compile_for_cores(1)
    with program_cache():
        _run_items(connection, make)
    sys.stderr.flush()
    os._exit(0)  # threads that the work has started would delay the end


def _run_items(connection: Connection, make: Make) -> None:
    work: Callable[[Any, Report], Any] | None = None
    while True:
        try:
            item = connection.recv()
        except (EOFError, OSError):
            return
        try:
            if work is None:
                work = make()
            result = work(item, lambda doing: connection.send(("report", doing)))
        except (InputError, PlatformError) as error:
            connection.send(("failed", str(error)))
        else:
            connection.send(("done", result))
