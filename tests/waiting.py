"""Waiting in tests: as long as a busy machine needs, but not for ever."""

import time
from collections.abc import Callable

HANGS_S = 600.0
"""What takes so long hangs: nothing here takes more than some seconds on an idle machine."""


def wait_until(condition: Callable[[], object]) -> None:
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < HANGS_S, "it hangs"
        time.sleep(0.05)
