"""Run the pieces of a study in processes, one per core, and show how many are finished."""

import signal
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

from skystack.compilation.cores import cores
from skystack.compilation.programs import compile_for_cores
from skystack.io.parents import end_with_parent
from skystack.reproduction.processes import stop_workers

Result = TypeVar("Result")
INTERRUPTED = 130
"""The exit code of a study that was interrupted with Ctrl-C."""
TO_RESUME = "interrupted: run the same command again to resume\n"


def run_pieces(
    work: Callable[..., Result], pieces: Sequence[tuple[object, ...]], what: str
) -> list[Result]:
    """The results of all pieces, in order. `work` gets the elements of a piece as arguments.

    Pieces start in order. If one fails, the others are stopped. Raises SystemExit after Ctrl-C.
    `what` names the pieces in the progress messages on standard error. `work` must store its
    results, so that an interrupted study can be resumed.
    """
    started = time.monotonic()
    pool = ProcessPoolExecutor(len(cores()), get_context("spawn"), _start)
    try:
        futures = [pool.submit(work, *piece) for piece in pieces]
        for number, future in enumerate(as_completed(futures), start=1):
            future.result()
            minutes = (time.monotonic() - started) / 60.0
            sys.stderr.write(f"{number} of {len(pieces)} {what} finished, {minutes:.0f} min\n")
        return [future.result() for future in futures]
    except KeyboardInterrupt:
        stop_workers()
        sys.stderr.write(TO_RESUME)
        raise SystemExit(INTERRUPTED) from None
    except BaseException:
        stop_workers()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _start() -> None:
    """Prepare a process of the pool. Only the parent handles Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    compile_for_cores(1)
