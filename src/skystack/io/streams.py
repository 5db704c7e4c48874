"""Standard output and standard error: everything that a command prints goes through here.

Results go to standard output; if they cannot be written, the command fails. Messages go to standard
error; write errors there are ignored. Characters that a stream's encoding lacks are escaped.
"""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from skystack.errors import InputError


class ClosedPipeError(Exception):
    """The reader of standard output has closed the pipe."""


class StandardOutput:
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
        """Flush what was written; without a standard output there is nothing to flush."""
        with _refusals(self._stream):
            if self._stream is not None:
                self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class StandardError:
    """Standard error as a text file; write errors are ignored: nowhere is left to report them."""

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
    """Write characters that a stream's encoding lacks as escapes, inside the context."""
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

    Otherwise the next file opened would get a standard file descriptor, and whatever a library
    writes there would end up in it. Python's streams exist by now: `sys.stdout` stays None.
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
    """Discard what the stream still buffers, or Python would report an error at exit."""
    with suppress(OSError, ValueError, AttributeError):
        handle = os.open(os.devnull, os.O_WRONLY)
        os.dup2(handle, stream.fileno())
        os.close(handle)
