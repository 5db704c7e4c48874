"""JAX programs are compiled for a fixed number of cores, and cached on disk."""

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
from jax._src.compilation_cache import decompress_executable  # there is no public equivalent
from jax.experimental.compilation_cache import compilation_cache

from skystack.compilation.cores import cores, processor_lines
from skystack.errors import InputError
from skystack.io.files import scratch_folder
from skystack.io.locks import LOCK, is_abandoned, locked_folder

CACHE_VARIABLE = "SKYSTACK_CACHE"
"""The environment variable for the folder of compiled programs; `off` disables the cache."""
CORES_VARIABLE = "NPROC"
"""The environment variable for the number of cores that JAX detects."""
IDLE_S = 60.0
"""An unlocked folder that has been idle for longer belongs to a killed process."""
RUNNING = "running-"
"""The prefix of the folders that JAX works in."""
MOST_BYTES = 512 * 1024**2
"""The maximum size of the cache; the oldest programs are deleted beyond it."""


class _Target:
    """What this process compiles programs for."""

    cores: int | None = None
    """None: the cores that JAX detects."""


def compile_for_cores(count: int) -> None:
    """Compile JAX programs as on a machine with `count` cores. Call this before JAX is used.

    JAX splits sums among the cores that it detects. Their number affects the rounding, and so the
    course of a training. It is also the number of threads in which programs run.
    """
    _Target.cores = count
    # JAX's client for CPUs reads this variable when it starts.
    before = os.environ.get(CORES_VARIABLE)
    os.environ[CORES_VARIABLE] = str(count)
    try:
        jax.devices()
    finally:
        if before is None:
            del os.environ[CORES_VARIABLE]
        else:
            os.environ[CORES_VARIABLE] = before


def run_in_calling_threads() -> None:
    """Start each JAX program in the thread that calls it. Call this before JAX is used.

    If programs are compiled for several cores, several threads can then run programs at the same
    time. By default, JAX runs programs one after another in a thread of its own.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # type: ignore[no-untyped-call]


@contextmanager
def program_cache() -> Iterator[None]:
    """Inside the context, read compiled programs from the cache on disk and add new ones to it.

    JAX writes its files in place and does not check what it reads. It is therefore given a separate
    folder with links to the intact files. At the end, new intact files are moved to the cache;
    after an interruption, none are. Does nothing if JAX already has a cache folder or ours cannot
    be used: without the cache, programs are only compiled again.
    """
    configured: str | None = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    folder = None if configured else _folder()
    with ExitStack() as stack:
        work_folder = None if folder is None else _work_folder(folder, stack)
        if folder is None or work_folder is None:
            yield
            return
        _set_jax_cache(str(work_folder))
        try:
            with warnings.catch_warnings():
                # If the disk is full or the folder is gone, the program is still compiled.
                message = "Error (reading|writing) persistent compilation cache entry"
                warnings.filterwarnings("ignore", message)
                yield
        except Exception:
            _store(work_folder, folder)
            raise
        finally:
            _set_jax_cache(None)
        _store(work_folder, folder)


def _folder() -> Path | None:
    """The cache folder for this kind of machine and these versions; None if there is none."""
    configured = os.environ.get(CACHE_VARIABLE)
    if configured == "off":
        return None
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "skystack"
    try:
        folder = Path(configured or base).expanduser() / _fingerprint()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: no home directory
        return None
    return folder


def _work_folder(folder: Path, stack: ExitStack) -> Path | None:
    """A folder for JAX with links to the intact programs; damaged ones are deleted."""
    try:
        work_folder = stack.enter_context(scratch_folder(RUNNING, folder))
        stack.enter_context(locked_folder(work_folder))
        programs = _files(folder)
    except (OSError, InputError):
        return None
    for path in programs:
        with suppress(OSError):
            if path.suffix == _digest(path):
                os.link(path, work_folder / path.stem)
            else:
                path.unlink()
    return work_folder


def _fingerprint() -> str:
    """A digest of what a program depends on: versions, platform, processor, number of cores."""
    count = _Target.cores or len(cores())
    parts = [version("jax"), version("jaxlib"), platform.platform(), _instructions(), str(count)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _instructions() -> str:
    """The processor's model and features, as far as the system reports them."""
    lines = processor_lines("model name", "flags", "Features")
    return "\n".join(sorted(set(lines))) or f"{platform.machine()} {platform.processor()}"


def _set_jax_cache(folder: str | None) -> None:
    settings = {
        "jax_compilation_cache_dir": folder,
        "jax_persistent_cache_min_compile_time_secs": 0.2,
        # Otherwise the folder's name would become part of a program's cache key.
        "jax_persistent_cache_enable_xla_caches": "none",
    }
    for name, value in settings.items():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]
    compilation_cache.reset_cache()  # JAX reads the setting only once


def _store(work_folder: Path, folder: Path) -> None:
    """Move new, intact programs to names that end with the digest of the content."""
    with suppress(OSError):
        known = {path.stem for path in _files(folder)}
        for path in _files(work_folder):
            if path.name not in known and _is_complete(path):
                path.replace(folder / (path.name + _digest(path)))
        _clean(folder, work_folder)


def _clean(folder: Path, work_folder: Path) -> None:
    """Delete the oldest programs beyond the maximum size, and the folders of killed processes."""
    remaining = MOST_BYTES
    for _, size, path in sorted(_dated(path) for path in _files(folder))[::-1]:
        remaining -= size
        if remaining < 0:
            path.unlink(missing_ok=True)
    for path in folder.glob(f"{RUNNING}*"):
        if path != work_folder and is_abandoned(path, IDLE_S):
            shutil.rmtree(path, ignore_errors=True)


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.is_file() and path.name != LOCK]


def _dated(path: Path) -> tuple[float, int, Path]:
    status = path.stat()
    return status.st_mtime, status.st_size, path


def _digest(path: Path) -> str:
    return f".{hashlib.sha256(path.read_bytes()).hexdigest()[:32]}"


def _is_complete(path: Path) -> bool:
    """Whether JAX wrote the whole program: a full disk truncates the file."""
    try:
        decompress_executable(path.read_bytes())
    except Exception:  # each compression library raises its own exceptions
        return False
    return True
