"""Waiting in tests: long enough for a busy machine, but not forever."""

import time
from collections.abc import Callable

TIMEOUT_S = 600.0
"""Anything slower than this is considered hung; all tests take seconds on an idle machine."""


def wait_until(condition: Callable[[], object]) -> None:
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < TIMEOUT_S, "it hangs"
        time.sleep(0.05)
