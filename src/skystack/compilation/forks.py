"""Refuse to run in a process forked after JAX has started: it would wait for JAX's threads forever.

A forked process has JAX's state but not its threads. `multiprocessing` forks by default on Linux
before Python 3.14, as do vector environments that run in several processes. A fork before JAX has
started is harmless. This module does not import JAX.
"""

import os
import sys
from contextlib import suppress
from pathlib import Path

from skystack.errors import InputError


def refuse_forked() -> None:
    """Raise InputError if JAX was already running when this process was forked."""
    if _inherited["jax"]:
        raise InputError(
            "JAX was started before this process was forked and cannot run in it (allowed: the "
            'start methods spawn and forkserver, as in AsyncVectorEnv(..., context="spawn") or '
            'SubprocVecEnv(..., start_method="spawn"))'
        )


def _started() -> bool:
    """Whether JAX has started in this process. Asking a public function of JAX would start it."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    initialised = getattr(bridge, "backends_are_initialized", None)
    return initialised is not None and bool(initialised())


def _single_threaded() -> bool:
    """Whether this process has one thread; once JAX has started, only a forked process has one."""
    with suppress(OSError):  # not on Linux
        return len(list(Path("/proc/self/task").iterdir())) == 1
    return False


def _note_fork() -> None:
    _inherited["jax"] = _started()


# `_single_threaded` detects a child that imports this module only after the fork.
_inherited = {"jax": _started() and _single_threaded()}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)
