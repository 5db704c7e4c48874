"""Record what Python does to files and processes, through its audit events.

Compiled libraries raise no such events; files that they write must be found in another way.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax

_READS = {"os.listdir", "os.scandir"}
_WRITES = {
    *("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.truncate"),
    *("os.chmod", "os.chown", "os.utime", "os.mkfifo", "os.mknod"),
}
_EXECUTES = {
    *("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork"),
    *("socket.connect", "pickle.find_class", "ctypes.dlopen"),
}
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_ALLOWED = ("/proc/", "/sys/", "/dev/null", "/dev/urandom", "/usr/share/zoneinfo/")


class Watched:
    """Records forbidden accesses, such as those outside a folder."""

    def __init__(self, folder: Path, writes: bool) -> None:
        self._folder, self._writes = os.path.realpath(folder), writes
        ours = [sys.prefix, sys.base_prefix, str(Path(__file__).parents[2])]
        self._code = tuple(os.path.realpath(each) for each in ours)
        kept = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
        self._allowed = (*_ALLOWED, *([os.path.realpath(kept)] if kept else []))
        self.found: list[str] = []

    def record(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Record an event unless reading files in the folder needs it."""
        if event == "open":
            writes = bool(arguments[2] & _WRITING) if isinstance(arguments[2], int) else False
            self._record_path(event, arguments[0], writes)
        elif event in _READS:
            self._record_path(event, arguments[0], writes=False)
        elif event in _WRITES:
            paths = [each for each in arguments[:2] if isinstance(each, str | bytes | os.PathLike)]
            for path in paths:
                self._record_path(event, path, writes=True)
        elif event in _EXECUTES:
            self.found.append(f"{event} {str(arguments)[:100]}")

    def _record_path(self, event: str, given: Any, writes: bool) -> None:
        if not isinstance(given, str | bytes | os.PathLike):  # a file descriptor
            return
        path = _resolved(os.fsdecode(given))
        if path.startswith(self._allowed) or "__pycache__" in path:
            return
        inside = path == self._folder or path.startswith(self._folder + os.sep)
        code = path.startswith(self._code)
        if (inside and (self._writes or not writes)) or (code and not writes):
            return
        self.found.append(f"{event}{' to write' if writes else ''} {path[:200]}")


def _resolved(path: str) -> str:
    """The absolute path without links; an invalid path, as with a null byte, stays unchanged."""
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):
        return path


_watching: list[Watched] = []
_hooked: list[bool] = []


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _watching:
        watched = _watching.pop()  # ignore events of the recording itself
        try:
            watched.record(event, arguments)
        finally:
            _watching.append(watched)


@contextmanager
def watched(folder: Path, writes: bool = False) -> Iterator[Watched]:
    """Record all forbidden accesses in the context: reading outside the folder, writing (in the
    folder too, unless `writes`), executing and unpickling. Files of Python and of this project may
    be read.
    """
    if not _hooked:
        sys.addaudithook(_hook)  # cannot be removed
        _hooked.append(True)
    found = Watched(folder, writes)
    _watching.append(found)
    try:
        yield found
    finally:
        _watching.remove(found)
