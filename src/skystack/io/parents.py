"""Processes that end with their parents."""

import multiprocessing
import os
from threading import Thread
from typing import Any


def end_with_parent() -> None:
    """Exit when the parent ends. A killed parent cannot stop its workers, which hold its locks."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        Thread(target=_exit_after, args=(parent,), daemon=True).start()


def _exit_after(parent: Any) -> None:
    parent.join()
    os._exit(1)
