"""SIGINT and SIGTERM end a command: each is recorded, then raised as KeyboardInterrupt, never lost.

C++ libraries do not handle exceptions in every call to Python: JAX discards one raised in its
garbage-collection callback, and aborts the process if one is raised while it is imported. The
exception is therefore not raised during imports or inside JAX; raising is retried every 10 ms. If
it is discarded anyway, it is raised again, and code between compiled programs calls `check`. The
recorded signal decides the exit code. Inside `defer_signals` nothing is raised, so that critical
work is completed first.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TypeVar

ENDING = (signal.SIGINT, signal.SIGTERM)
DUPLICATE_WINDOW_S = 1.0
"""A second signal after this time ends the process immediately. An earlier one is a duplicate of
the first: a terminal and a parent process may both send it."""
RETRY_S = 0.01
"""The delay before the next attempt to raise the exception."""
POLL_S = 0.5
Result = TypeVar("Result")


class _State:
    """The received signal and how far it has been handled."""

    def __init__(self) -> None:
        self.watched = False
        self.reset()

    def reset(self) -> None:
        self.number: int | None = None
        self.at_s = 0.0
        self.raised = False
        """Whether KeyboardInterrupt was raised and has not been discarded."""
        self.deferrals = 0
        """The number of nested `defer_signals` blocks that the main thread is in."""


_state = _State()


@contextmanager
def handle_signals(last: bool = False) -> Iterator[None]:
    """Record and raise signals inside the context.

    Afterwards the previous handlers are restored or, with `last`, the system's defaults. Ignored
    signals stay ignored. Does nothing in other threads, or if already active.
    """
    if _state.watched or threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers: list[int] = [
        each for each in ENDING if signal.getsignal(each) not in (signal.SIG_IGN, None)
    ]
    before: dict[int, Any] = {}
    unraisable = sys.unraisablehook
    _state.reset()
    _state.watched = True
    sys.unraisablehook = _on_unraisable
    try:
        for each in numbers:
            before[each] = signal.signal(each, _on_signal)
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if last else handler)
        _schedule_retry(0.0)
        sys.unraisablehook = unraisable
        _state.watched = False


def exit_code() -> int | None:
    """The shell's exit code for a command ended by a signal; None if none was received."""
    return None if _state.number is None else 128 + _state.number


def record_only() -> None:
    """From now on only record signals, without raising them, until `handle_signals` ends."""
    _state.deferrals += 1


def forget() -> None:
    """Forget a signal that has been handled: the command continues and can end normally."""
    _schedule_retry(0.0)
    _state.reset()


def check() -> None:
    """Raise KeyboardInterrupt if a signal was received but its exception was discarded."""
    main = threading.current_thread() is threading.main_thread()
    if main and _state.watched and _state.number is not None and not _state.deferrals:
        _raise()


@contextmanager
def defer_signals() -> Iterator[None]:
    """Defer interruption of the main thread by signals until the context ends."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    cleaning_up = _state.raised
    _state.deferrals += 1
    try:
        yield
    finally:
        _state.deferrals -= 1
    if not cleaning_up:
        check()


def wait_for(future: Future[Result]) -> Result:
    """The result of a future. Polls, as a signal in another thread does not wake the main one."""
    while not wait([future], timeout=POLL_S).done:
        check()
    return future.result()


@contextmanager
def starting_processes() -> Iterator[None]:
    """`defer_signals`, with SIGINT blocked in the threads and processes started inside.

    A half-started process would be left behind and print a traceback.
    """
    from multiprocessing import resource_tracker  # noqa: PLC0415  (`--help` does not need it)

    with defer_signals():
        if not hasattr(signal, "pthread_sigmask"):
            yield
            return
        # Starting the tracker unblocks the signals, so it is started first.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _state.number is None:
        _state.number, _state.at_s = number, time.monotonic()
        _raise_in(frame)
    elif time.monotonic() - _state.at_s > DUPLICATE_WINDOW_S:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)


def _on_alarm(number: int, frame: FrameType | None) -> None:
    if _state.watched and _state.number is not None and not _state.raised:
        _raise_in(frame)


def _raise_in(frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt now, or later if the running code cannot handle exceptions."""
    if _state.deferrals:
        return  # raised when the `defer_signals` block ends
    if _is_delicate(frame):
        _schedule_retry(RETRY_S)
    else:
        _raise()


def _raise() -> NoReturn:
    _schedule_retry(0.0)
    _state.raised = True
    raise KeyboardInterrupt


def _is_delicate(frame: FrameType | None) -> bool:
    """Whether the running code is an import, or JAX code that skystack called."""
    delicate, nearest = tuple(_folder_of(name) for name in ("jax", "jaxlib")), ""
    while frame is not None:
        path = frame.f_code.co_filename
        if path.startswith("<frozen importlib"):
            return True
        if not nearest and path.startswith((*delicate, _OURS)):
            nearest = path
        frame = frame.f_back
    return nearest.startswith(delicate)


def _folder_of(package: str) -> str:
    """The folder of a loaded package."""
    file = getattr(sys.modules.get(package), "__file__", None)
    return f"{Path(file).parent}{os.sep}" if file else "not loaded"


_OURS = _folder_of("skystack")


def _on_unraisable(what: Any) -> None:
    """Retry a KeyboardInterrupt that Python has to discard."""
    if _state.number is not None and issubclass(what.exc_type, KeyboardInterrupt):
        _state.raised = False
        _schedule_retry(RETRY_S)
    else:
        sys.__unraisablehook__(what)


def _schedule_retry(after_s: float) -> None:
    """Set the timer for the next attempt; 0 cancels it."""
    if not hasattr(signal, "setitimer"):
        return  # not a POSIX system: the next check raises it
    if after_s:
        signal.signal(signal.SIGALRM, _on_alarm)
    with suppress(OSError):
        signal.setitimer(signal.ITIMER_REAL, after_s)
