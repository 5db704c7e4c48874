"""The cache of compiled programs: reuse, damaged files, and folders that cannot be used."""

import math
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from skystack.compilation import programs
from skystack.compilation.programs import program_cache
from skystack.io.locks import locked_folder

PROGRAM = """
import sys
import jax, jax.numpy as jnp
from skystack.compilation.programs import program_cache
missed = []
jax.monitoring.register_event_listener(
    lambda event, **_: event.endswith("cache_misses") and missed.append(event)
)
with program_cache():
    # Cache the program, however fast it is compiled.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    {inside}
    total = float(jax.jit(lambda x: jnp.sin(x) @ x)(jnp.eye(3)).sum())
    {after}
print(total, len(missed))
"""
TOTAL = 3 * math.sin(1.0)
"""What the program computes."""


def command(inside="pass", after="pass"):
    return [sys.executable, "-c", PROGRAM.format(inside=inside, after=after)]


def run(cache, inside="pass", after="pass", **variables):
    """Run the program and return how many programs it compiled; any warning is an error."""
    environment = os.environ | {"SKYSTACK_CACHE": str(cache), "PYTHONWARNINGS": "error"}
    completed = subprocess.run(
        command(inside, after),
        env=environment | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (completed.returncode, completed.stderr) == (0, "")
    total, missed = completed.stdout.split()
    assert float(total) == pytest.approx(TOTAL, rel=1e-5)
    return int(missed)


def cached_files(cache):
    (folder,) = cache.iterdir()
    return sorted(folder.iterdir())


@pytest.mark.slow
def test_second_run_compiles_nothing(tmp_path):
    assert run(tmp_path) > 0
    first = cached_files(tmp_path)
    assert first
    assert not any(path.name.startswith("running-") for path in first)
    assert run(tmp_path) == 0
    assert cached_files(tmp_path) == first


@pytest.mark.slow
def test_killed_run_leaves_only_its_work_folder(tmp_path):
    environment = os.environ | {"SKYSTACK_CACHE": str(tmp_path)}
    killed = command(after="import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    subprocess.run(killed, env=environment, check=False)
    assert [path.name.startswith("running-") for path in cached_files(tmp_path)] == [True]
    assert run(tmp_path) > 0


@pytest.mark.slow
def test_damaged_programs_are_deleted_and_recompiled(tmp_path):
    """Truncated, empty, with one bit changed, or from a version without digests in the names."""
    compiled = run(tmp_path)
    first = cached_files(tmp_path)
    whole = {path: path.read_bytes() for path in first}
    for path, data in whole.items():
        damages = [data[:-1], data[: len(data) // 2], b"", bytes([data[0] ^ 1]) + data[1:]]
        for damage in damages[: 4 if path == first[0] else 1]:
            path.unlink()
            path.write_bytes(damage)
            with ExitStack() as stack:
                work_folder = programs._work_folder(path.parent, stack)
                assert not path.exists()
                assert not (work_folder / path.stem).exists()
            path.write_bytes(data)
    for path, data in whole.items():
        path.unlink()
        path.with_suffix("").write_bytes(data[:-1])
    assert run(tmp_path) == compiled
    assert {path.stem for path in cached_files(tmp_path) if path.is_file()} == {
        p.stem for p in first
    }
    assert run(tmp_path) == 0


FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))"
FREE = "resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)"


@pytest.mark.slow
def test_programs_truncated_by_a_full_disk_are_not_cached(tmp_path):
    """Files are cut at 1,000 bytes while JAX writes; the limit is lifted before they are moved."""
    ignored = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)"
    written = "Path(jax.config.jax_compilation_cache_dir).glob('*-cache')"
    cut = f"assert {{p.stat().st_size for p in {written}}}"
    after = f"{FREE}; from pathlib import Path; {cut} == {{1000}}"
    compiled = run(tmp_path, inside=f"{FULL}; {ignored}", after=after)
    assert compiled > 0
    assert cached_files(tmp_path) == []
    assert run(tmp_path) == compiled
    assert run(tmp_path) == 0


@pytest.mark.slow
def test_later_run_deletes_leftovers_of_killed_runs(tmp_path):
    run(tmp_path)
    (folder,) = tmp_path.iterdir()
    for name in ("running-killed", "running-new", "running-at-work"):
        (folder / name).mkdir()
    hour_ago, later = time.time() - 3600.0, time.time() + 3600.0
    os.utime(folder / "running-new", (later, later))
    with locked_folder(folder / "running-at-work"):
        for name in ("running-killed", "running-at-work"):
            os.utime(folder / name, (hour_ago, hour_ago))
        run(tmp_path)
    left = {path.name for path in cached_files(tmp_path) if path.name.startswith("running-")}
    assert left == {"running-new", "running-at-work"}


@pytest.mark.parametrize("setting", ["off", "/proc/nowhere", "~nobody-of-this-name/cache"])
def test_compiles_without_a_cache_folder(setting, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(setting)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_file_in_place_of_the_folder_is_left_alone(tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    run(file)
    run(file / "cache")
    assert file.read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize(
    "deletion",
    [
        "shutil.rmtree(folder)",
        "shutil.rmtree(folder.parent); folder.parent.write_text('')",
        "shutil.rmtree(folder); folder.write_text('')",
    ],
)
@pytest.mark.parametrize("when", ["inside", "after"])
def test_folder_may_disappear_during_the_run(tmp_path, deletion, when):
    find_folder = "import shutil; from pathlib import Path"
    find_folder += "; folder = Path(jax.config.jax_compilation_cache_dir)"
    run(tmp_path, **{when: f"{find_folder}; {deletion}"})


def test_no_home_directory_means_no_cache(monkeypatch):
    """Neither HOME nor an entry in the list of users."""
    pwd = pytest.importorskip("pwd")

    def unknown(_):
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in ("HOME", "XDG_CACHE_HOME", programs.CACHE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    assert programs._folder() is None
    with program_cache():
        pass


def test_a_full_disk_means_no_cache(monkeypatch, tmp_path):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "mkdtemp", full)
    with ExitStack() as stack:
        assert programs._work_folder(tmp_path, stack) is None


def test_deletes_the_oldest_programs_beyond_the_limit(monkeypatch, tmp_path):
    monkeypatch.setattr(programs, "MOST_BYTES", 25)
    for age, name in enumerate("abcd"):
        (tmp_path / name).write_bytes(b"x" * 10)
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    for name in ("running-old", "running-new"):
        (tmp_path / name).mkdir()
    os.utime(tmp_path / "running-old", (1e9, 1e9))
    programs._clean(tmp_path, tmp_path / "running-mine")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "running-new"]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="Linux")
@pytest.mark.parametrize("count", [1, 2, 5])
def test_there_is_a_thread_for_each_core_compiled_for(count):
    """On any machine. The threads may run on all cores, and the environment stays as it is."""
    program = f"""
import os
from pathlib import Path
from skystack.compilation.programs import compile_for_cores
before = os.sched_getaffinity(0), dict(os.environ)
compile_for_cores({count})
tasks = list(Path("/proc/self/task").iterdir())
threads = [int(task.name) for task in tasks if "XLAEigen" in (task / "comm").read_text()]
assert all(os.sched_getaffinity(thread) == before[0] for thread in threads)
assert dict(os.environ) == before[1]
print(len(threads))
"""
    completed = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert int(completed.stdout) == count


@pytest.mark.slow
@pytest.mark.parametrize("in_calling_threads", [False, True])
def test_which_thread_runs_a_program(in_calling_threads):
    """By default, a program's processor time is spent in another thread than the caller's."""
    program = f"""
import time
import jax
from skystack.compilation.programs import compile_for_cores, run_in_calling_threads
if {in_calling_threads}:
    run_in_calling_threads()
compile_for_cores(1)
multiply = jax.jit(lambda x: jax.lax.fori_loop(0, 300, lambda _, y: jax.numpy.sin(y) @ y, x))
one = jax.block_until_ready(multiply(jax.numpy.ones((200, 200))))
before = time.thread_time(), time.process_time()
jax.block_until_ready(multiply(one))
print((time.thread_time() - before[0]) / (time.process_time() - before[1]))
"""
    completed = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert (float(completed.stdout) > 0.5) == in_calling_threads
