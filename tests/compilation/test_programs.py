"""Compiled programs are kept between runs, whole, and never in the way."""

import math
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack

import pytest

from skystack.compilation import programs
from skystack.compilation.programs import kept_programs
from skystack.io.locks import locked_folder

PROGRAM = """
import sys
import jax, jax.numpy as jnp
from skystack.compilation.programs import kept_programs
missed = []
jax.monitoring.register_event_listener(
    lambda event, **_: event.endswith("cache_misses") and missed.append(event)
)
with kept_programs():
    # However fast it is compiled, it is kept.
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
    """What it computed and how many programs it compiled; any warning is an error."""
    environment = os.environ | {"SKYSTACK_CACHE": str(cache), "PYTHONWARNINGS": "error"}
    done = subprocess.run(
        command(inside, after),
        env=environment | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    total, missed = done.stdout.split()
    assert float(total) == pytest.approx(TOTAL, rel=1e-5)
    return int(missed)


def kept(cache):
    (folder,) = cache.iterdir()
    return sorted(folder.iterdir())


def test_a_second_run_compiles_nothing(tmp_path):
    assert run(tmp_path) > 0
    first = kept(tmp_path)
    assert first
    assert not any(path.name.startswith("running-") for path in first)
    assert run(tmp_path) == 0
    assert kept(tmp_path) == first


def test_a_run_that_is_killed_leaves_nothing_under_a_programs_name(tmp_path):
    environment = os.environ | {"SKYSTACK_CACHE": str(tmp_path)}
    killed = command(after="import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    subprocess.run(killed, env=environment, check=False)
    assert [path.name.startswith("running-") for path in kept(tmp_path)] == [True]
    assert run(tmp_path) > 0


def test_damaged_programs_are_dropped_and_compiled_again(tmp_path):
    """Cut short, empty, changed in one bit, or of a version that gave them no digest."""
    compiled = run(tmp_path)
    first = kept(tmp_path)
    whole = {path: path.read_bytes() for path in first}
    for path, data in whole.items():
        damages = [data[:-1], data[: len(data) // 2], b"", bytes([data[0] ^ 1]) + data[1:]]
        for damage in damages[: 4 if path == first[0] else 1]:
            path.unlink()
            path.write_bytes(damage)
            with ExitStack() as stack:
                left = programs._work_folder(path.parent, stack)
                assert not path.exists()
                assert not (left / path.stem).exists()
            path.write_bytes(data)
    for path, data in whole.items():
        path.unlink()
        path.with_suffix("").write_bytes(data[:-1])
    assert run(tmp_path) == compiled
    assert {path.stem for path in kept(tmp_path) if path.is_file()} == {p.stem for p in first}
    assert run(tmp_path) == 0


FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))"
FREE = "resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)"


def test_a_program_truncated_by_a_full_disk_is_not_kept(tmp_path):
    """Files end at 1,000 bytes while JAX writes; there is room again when they are moved."""
    ignored = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)"
    written = "Path(jax.config.jax_compilation_cache_dir).glob('*-cache')"
    cut = f"assert {{p.stat().st_size for p in {written}}}"
    after = f"{FREE}; from pathlib import Path; {cut} == {{1000}}"
    compiled = run(tmp_path, inside=f"{FULL}; {ignored}", after=after)
    assert compiled > 0
    assert kept(tmp_path) == []
    assert run(tmp_path) == compiled
    assert run(tmp_path) == 0


def test_leftovers_of_a_killed_run_are_deleted_by_a_later_one(tmp_path):
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
    left = {path.name for path in kept(tmp_path) if path.name.startswith("running-")}
    assert left == {"running-new", "running-at-work"}


@pytest.mark.parametrize("named", ["off", "/proc/nowhere", "~nobody-of-this-name/cache"])
def test_without_a_folder_programs_are_compiled(named, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(named)
    assert list(tmp_path.iterdir()) == []


def test_a_file_where_the_folder_should_be_is_left_alone(tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    run(file)
    run(file / "cache")
    assert file.read_text() == "mine"


@pytest.mark.parametrize(
    "gone",
    [
        "shutil.rmtree(folder)",
        "shutil.rmtree(folder.parent); folder.parent.write_text('')",
        "shutil.rmtree(folder); folder.write_text('')",
    ],
)
@pytest.mark.parametrize("when", ["inside", "after"])
def test_a_folder_may_vanish_during_the_run(tmp_path, gone, when):
    find = "import shutil; from pathlib import Path"
    find += "; folder = Path(jax.config.jax_compilation_cache_dir)"
    run(tmp_path, **{when: f"{find}; {gone}"})


def test_no_home_directory_means_no_cache(monkeypatch):
    """No HOME, and no line in the list of users either."""
    pwd = pytest.importorskip("pwd")

    def unknown(_):
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in ("HOME", "XDG_CACHE_HOME", programs.CACHE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    assert programs._folder() is None
    with kept_programs():
        pass


def test_a_full_disk_means_no_cache(monkeypatch, tmp_path):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "mkdtemp", full)
    with ExitStack() as stack:
        assert programs._work_folder(tmp_path, stack) is None


def test_the_oldest_programs_make_room(monkeypatch, tmp_path):
    monkeypatch.setattr(programs, "MOST_BYTES", 25)
    for age, name in enumerate("abcd"):
        (tmp_path / name).write_bytes(b"x" * 10)
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    for name in ("running-old", "running-new"):
        (tmp_path / name).mkdir()
    os.utime(tmp_path / "running-old", (1e9, 1e9))
    programs._clean(tmp_path, tmp_path / "running-mine")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "running-new"]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux")
def test_programs_for_one_core_run_on_any():
    """Two trainings side by side do not wait for the same core."""
    program = """
import math
import os
from pathlib import Path
from skystack.compilation.programs import compile_for_one_core
before = os.sched_getaffinity(0)
compile_for_one_core()
threads = [int(path.name) for path in Path("/proc/self/task").iterdir()]
bound = [thread for thread in threads if os.sched_getaffinity(thread) != before]
print(len(bound), int(len(threads) > 1))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["0", "1"]
