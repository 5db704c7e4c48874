"""How JAX's programs are made here: for one core, and kept on disk, so that each is made once."""

import hashlib
import os
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

from skystack.cores import processor_lines
from skystack.files import LOCK, alone_in, is_abandoned, scratch_folder

CACHE_VARIABLE = "SKYSTACK_CACHE"
"""Names the folder for compiled programs; `off` keeps none."""
IDLE_S = 60.0
"""Whose folder has not been locked by then never will be: its process was killed."""
_RUNNING = "running-"
MOST_BYTES = 512 * 1024**2
"""Beyond this the oldest are deleted."""


def compile_for_one_core() -> None:
    """Make JAX's programs those of a machine with one core; before JAX is used.

    JAX splits sums among the cores that it sees, their number decides how they are rounded, and
    that decides how a training goes. Its threads then run wherever there is room.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    everything = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(everything)})
    jax.devices()
    for thread in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it has ended
            os.sched_setaffinity(int(thread.name), everything)


@contextmanager
def kept_programs() -> Iterator[None]:
    """Within it, programs that were compiled before are read from disk, and new ones are kept.

    JAX writes its files in place, so it is given a folder of its own with links to what is there;
    what it adds is moved over when all is done, whole; after an interruption, nothing. Does nothing
    where JAX has a folder for its programs already, or ours cannot be written.
    """
    already: str | None = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    folder = None if already else _folder()
    if folder is None:
        yield
        return
    with scratch_folder(_RUNNING, folder) as mine, alone_in(mine):
        _link(folder, mine)
        _use(str(mine))
        try:
            yield
        except Exception:
            _keep(mine, folder)
            raise
        finally:
            _use(None)
        _keep(mine, folder)


def _folder() -> Path | None:
    """The folder for this kind of machine and these versions; None for none."""
    named = os.environ.get(CACHE_VARIABLE)
    if named == "off":
        return None
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "skystack"
    folder = Path(named or base).expanduser() / _fingerprint()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def _fingerprint() -> str:
    """A program runs on processors with the same instructions, under the same versions."""
    cores = 1 if hasattr(os, "sched_setaffinity") else os.cpu_count()
    words = [version("jax"), version("jaxlib"), platform.platform(), _instructions(), str(cores)]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]


def _instructions() -> str:
    """The processor's model and what it can do, as far as the system tells."""
    lines = processor_lines("model name", "flags", "Features")
    return "\n".join(sorted(set(lines))) or f"{platform.machine()} {platform.processor()}"


def _use(folder: str | None) -> None:
    settings = {
        "jax_compilation_cache_dir": folder,
        "jax_persistent_cache_min_compile_time_secs": 0.2,
        # Would make the name of the folder a part of what a program is looked up by.
        "jax_persistent_cache_enable_xla_caches": "none",
    }
    for name, value in settings.items():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]
    compilation_cache.reset_cache()  # it looks for the folder once only


def _link(folder: Path, mine: Path) -> None:
    for path in folder.iterdir():
        with suppress(OSError):
            if path.is_file():
                os.link(path, mine / path.name)


def _keep(mine: Path, folder: Path) -> None:
    with suppress(OSError):
        for path in mine.iterdir():
            if path.name != LOCK and not (folder / path.name).exists():
                path.replace(folder / path.name)
        left = MOST_BYTES
        for path in sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime):
            if path.is_file():
                left -= path.stat().st_size
                if left < 0:
                    path.unlink(missing_ok=True)
            elif path.name.startswith(_RUNNING) and path != mine and is_abandoned(path, IDLE_S):
                shutil.rmtree(path, ignore_errors=True)
