"""Compiled programs are kept between runs, whole, and never in the way."""

import os
import subprocess
import sys
import time

import pytest

from skystack.files import alone_in

PROGRAM = """
import jax, jax.numpy as jnp
from skystack.programs import kept_programs
compiled = []
jax.monitoring.register_event_listener(lambda event, **_: compiled.append(event))
def slow(x):
    for _ in range(150):
        x = jnp.sin(x) @ x
    return x
with kept_programs():
    total = float(jax.jit(slow)(jnp.eye(3)).sum())
    print(total, compiled.count("/jax/compilation_cache/cache_hits"))
"""


def run(cache, program=PROGRAM):
    environment = os.environ | {"SKYSTACK_CACHE": str(cache), "PYTHONWARNINGS": "error"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    total, hits = done.stdout.split()
    return float(total), int(hits)


def kept(cache):
    (folder,) = cache.iterdir()
    return sorted(folder.iterdir())


def test_a_second_run_compiles_nothing(tmp_path):
    first, hits = run(tmp_path)
    assert hits == 0
    (program,) = kept(tmp_path)  # and no folder of the run's own
    again, hits = run(tmp_path)
    assert (again, hits) == (first, 1)
    assert kept(tmp_path) == [program]


def test_a_run_that_is_killed_leaves_nothing_under_a_programs_name(tmp_path):
    killed = PROGRAM + "    import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n"
    environment = os.environ | {"SKYSTACK_CACHE": str(tmp_path)}
    subprocess.run([sys.executable, "-c", killed], env=environment, check=False)
    assert [path.name.startswith("running-") for path in kept(tmp_path)] == [True]
    assert run(tmp_path)[1] == 0


def test_what_a_killed_run_left_is_deleted_by_a_later_one(tmp_path):
    run(tmp_path)
    (folder,) = tmp_path.iterdir()
    for name in ("running-killed", "running-new", "running-at-work"):
        (folder / name).mkdir()
    hour_ago = time.time() - 3600.0
    with alone_in(folder / "running-at-work"):
        for name in ("running-killed", "running-at-work"):
            os.utime(folder / name, (hour_ago, hour_ago))
        run(tmp_path)
    left = {path.name for path in kept(tmp_path) if path.name.startswith("running-")}
    assert left == {"running-new", "running-at-work"}


@pytest.mark.parametrize("named", ["off", "/proc/nowhere"])
def test_without_a_folder_programs_are_compiled(named, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(named)
    assert run(named)[1] == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux")
def test_programs_for_one_core_run_on_any(tmp_path):
    """Two trainings side by side do not wait for the same core."""
    program = """
import os
from pathlib import Path
from skystack.programs import compile_for_one_core
before = os.sched_getaffinity(0)
compile_for_one_core()
threads = [int(path.name) for path in Path("/proc/self/task").iterdir()]
bound = [thread for thread in threads if os.sched_getaffinity(thread) != before]
print(len(bound), int(len(threads) > 1))
"""
    assert run(tmp_path, program) == (0.0, 1)
