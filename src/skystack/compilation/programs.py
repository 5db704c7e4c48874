"""How JAX's programs are made here: for one core, and kept on disk, so that each is made once."""

import hashlib
import os
import platform
import shutil
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

import jax
from jax._src.compilation_cache import decompress_executable  # no public name does it
from jax.experimental.compilation_cache import compilation_cache

from skystack.compilation.cores import processor_lines
from skystack.errors import InputError
from skystack.io.files import scratch_folder
from skystack.io.locks import LOCK, is_abandoned, locked_folder

CACHE_VARIABLE = "SKYSTACK_CACHE"
"""Names the folder for compiled programs; `off` keeps none."""
IDLE_S = 60.0
"""An unlocked folder older than this belongs to a process that was killed."""
RUNNING = "running-"
"""Prefix of the folders that JAX works in."""
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

    JAX writes its files in place and reads whatever is there. So it is given a folder of its own
    with links to the files that are whole, and what it adds is moved over when all is done, if it
    is whole; after an interruption, nothing. Does nothing where JAX has a folder for its programs
    already, or ours cannot be used: programs that are not kept cost time and nothing else.
    """
    already: str | None = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    folder = None if already else _folder()
    with ExitStack() as stack:
        mine = None if folder is None else _own_folder(folder, stack)
        if folder is None or mine is None:
            yield
            return
        _use(str(mine))
        try:
            with warnings.catch_warnings():
                # With a full disk or a deleted folder the program is still compiled.
                message = "Error (reading|writing) persistent compilation cache entry"
                warnings.filterwarnings("ignore", message)
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
    try:
        folder = Path(named or base).expanduser() / _fingerprint()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: no home directory
        return None
    return folder


def _own_folder(folder: Path, stack: ExitStack) -> Path | None:
    """A folder for JAX with links to the intact programs; damaged ones are deleted."""
    try:
        mine = stack.enter_context(scratch_folder(RUNNING, folder))
        stack.enter_context(locked_folder(mine))
        kept = _files(folder)
    except (OSError, InputError):
        return None
    for path in kept:
        with suppress(OSError):
            if path.suffix == _digest(path):
                os.link(path, mine / path.stem)
            else:
                path.unlink()
    return mine


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


def _keep(mine: Path, folder: Path) -> None:
    """Move new, intact programs to names that end with the digest of the content."""
    with suppress(OSError):
        known = {path.stem for path in _files(folder)}
        for path in _files(mine):
            if path.name not in known and _whole(path):
                path.replace(folder / (path.name + _digest(path)))
        _clean(folder, mine)


def _clean(folder: Path, mine: Path) -> None:
    """Delete the oldest programs beyond what may be kept, and what killed processes left."""
    left = MOST_BYTES
    for _, size, path in sorted(_dated(path) for path in _files(folder))[::-1]:
        left -= size
        if left < 0:
            path.unlink(missing_ok=True)
    for path in folder.glob(f"{RUNNING}*"):
        if path != mine and is_abandoned(path, IDLE_S):
            shutil.rmtree(path, ignore_errors=True)


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.is_file() and path.name != LOCK]


def _dated(path: Path) -> tuple[float, int, Path]:
    status = path.stat()
    return status.st_mtime, status.st_size, path


def _digest(path: Path) -> str:
    return f".{hashlib.sha256(path.read_bytes()).hexdigest()[:32]}"


def _whole(path: Path) -> bool:
    """Whether JAX wrote a program completely: a full disk truncates the file."""
    try:
        decompress_executable(path.read_bytes())
    except Exception:  # each compression library raises its own
        return False
    return True
