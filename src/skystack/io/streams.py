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
    """Standard output as a text file. Raises InputError if it cannot be written to."""

    def __init__(self) -> None:
        self._stream = sys.stdout

    def write(self, text: str) -> int:
        """Write all of the text or raise."""
        with _write_errors(self._stream):
            if self._stream is None:  # closed before Python started
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush the buffer; without a standard output there is nothing to flush."""
        with _write_errors(self._stream):
            if self._stream is not None:
                self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class StandardError:
    """Standard error as a text file. Write errors are ignored: they cannot be reported anywhere."""

    def __init__(self) -> None:
        self._stream = sys.stderr

    def write(self, text: str) -> int:
        if self._stream is not None:  # None: closed before Python started
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
    """Inside the context, escape characters that a stream's encoding lacks."""
    previous = []
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            previous.append((stream, stream.errors))
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        for stream, errors in previous:
            with suppress(OSError, ValueError):  # the buffer cannot be flushed
                stream.reconfigure(errors=errors)


def open_standard_files() -> None:
    """Open the null device in place of closed standard files.

    Otherwise the next file opened would get a standard file descriptor and receive what libraries
    write there. Python's streams already exist: `sys.stdout` stays None.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free descriptor: this one


@contextmanager
def _write_errors(stream: Any) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        _discard_buffer(stream)
        raise ClosedPipeError from None
    except OSError as error:
        _discard_buffer(stream)
        raise InputError(f"standard output cannot be written to: {error.strerror}") from None


def _discard_buffer(stream: Any) -> None:
    """Discard the stream's buffer; otherwise Python would report an error at exit."""
    with suppress(OSError, ValueError, AttributeError):
        handle = os.open(os.devnull, os.O_WRONLY)
        os.dup2(handle, stream.fileno())
        os.close(handle)
