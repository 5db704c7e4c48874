"""Memory that compilation has used is returned to the operating system."""

import ctypes
from contextlib import suppress


def return_freed_memory() -> None:
    """Return freed memory to the operating system, if the C library can (glibc).

    The compiler runs in several threads, and glibc keeps what each of them has freed.
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library, or no library at all
        ctypes.CDLL(None).malloc_trim(0)
