"""Forked processes: a copy of a process has JAX's state without its threads, and waits forever.

`multiprocessing` forks by default on Linux before Python 3.14, and so do vector environments that
run in several processes. A fork before JAX has started is harmless. Needs no JAX.
"""

import os
import sys
from contextlib import suppress
from pathlib import Path

from skystack.errors import InputError


def refuse_forked() -> None:
    """Raises InputError where JAX was already running when this process was forked."""
    if _inherited["jax"]:
        raise InputError(
            "JAX was started before this process was forked and cannot run in it (allowed: the "
            'start methods spawn and forkserver, as in AsyncVectorEnv(..., context="spawn") or '
            'SubprocVecEnv(..., start_method="spawn"))'
        )


def _started() -> bool:
    """Whether JAX runs in this process. It has no public function that asks without starting it."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    asked = getattr(bridge, "backends_are_initialized", None)
    return asked is not None and bool(asked())


def _alone() -> bool:
    """Whether this process has a single thread, as only a forked copy can have with JAX started."""
    with suppress(OSError):  # not on Linux
        return len(list(Path("/proc/self/task").iterdir())) == 1
    return False


def _note_fork() -> None:
    _inherited["jax"] = _started()


# The second half is for a child that imports this module only after the fork.
_inherited = {"jax": _started() and _alone()}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)
