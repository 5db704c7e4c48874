"""Standard output and standard error: all that a command prints goes through here.

Results go to standard output: where they cannot be written, the command fails. Prose goes to
standard error, as far as anybody takes it. Both escape what a stream's encoding lacks.
"""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from skystack.errors import InputError


class ClosedPipeError(Exception):
    """Nobody reads standard output any more."""


class Results:
    """Standard output as a file for text. Raises InputError when it cannot be written to."""

    def __init__(self) -> None:
        self._stream = sys.stdout

    def write(self, text: str) -> int:
        """Write all of the text, or fail."""
        with _refusals(self._stream):
            if self._stream is None:  # closed before Python began
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Hand over what was written; without a standard output nothing was."""
        with _refusals(self._stream):
            if self._stream is not None:
                self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class Prose:
    """Standard error as a file for text; what it does not take is lost: there is no other way."""

    def __init__(self) -> None:
        self._stream = sys.stderr

    def write(self, text: str) -> int:
        if self._stream is not None:  # closed before Python began
            with suppress(OSError):
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        if self._stream is not None:
            with suppress(OSError):
                self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def escaping() -> Iterator[None]:
    """Within it, characters that a stream's encoding lacks are written as escapes."""
    before = []
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            before.append((stream, stream.errors))
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        for stream, errors in before:
            with suppress(OSError, ValueError):  # what it holds cannot be written
                stream.reconfigure(errors=errors)


def open_standard_files() -> None:
    """Open the null device in place of standard files that are closed.

    Otherwise the next file that is opened takes the number of one, and whatever a library writes
    there lands in it. Python has made its own streams by now: `sys.stdout` stays None.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one


@contextmanager
def _refusals(stream: Any) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        _give_up(stream)
        raise ClosedPipeError from None
    except OSError as error:
        _give_up(stream)
        raise InputError(f"standard output cannot be written to: {error.strerror}") from None


def _give_up(stream: Any) -> None:
    """Let what the stream still holds go nowhere: Python would complain of it at exit."""
    with suppress(OSError, ValueError, AttributeError):
        handle = os.open(os.devnull, os.O_WRONLY)
        os.dup2(handle, stream.fileno())
        os.close(handle)
