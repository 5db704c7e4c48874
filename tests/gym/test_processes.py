"""Environments in several processes work or fail with a one-line error; they never hang."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from skystack.errors import InputError
from tests.waiting import TIMEOUT_S

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")

SCRIPT = Path(__file__).with_name("forking.py")
FORK_ERROR = "InputError: JAX was started before this process was forked"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run a case of `forking.py` in a new process; returns its result and its standard error."""
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path_factory.mktemp("compiled")),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }

    def case(name):
        command = [sys.executable, str(SCRIPT), name]
        done = subprocess.run(
            command,
            env=os.environ | cache,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1]), done.stderr

    return case


@pytest.mark.slow
@pytest.mark.parametrize("case", ["async_forked", "async_spawned", "async_forkserver"])
def test_asynchronous_environments_agree_with_synchronous_ones(run, case):
    """`async_forked` uses the default context, in a process that has not used JAX yet."""
    assert run(case)[0] is True


@pytest.mark.slow
def test_late_fork_of_asynchronous_workers_raises_in_the_parent(run):
    (kind, message), _ = run("async_forked_too_late")
    assert kind == "InputError"
    assert 'AsyncVectorEnv(..., context="spawn")' in message
    assert "\n" not in message


@pytest.mark.slow
def test_late_fork_of_stable_baselines3_workers_prints_the_error(run):
    pytest.importorskip("stable_baselines3")
    assert run("sb3_forked")[0] is True
    result, stderr = run("sb3_forked_too_late")
    assert result == "ended"
    assert FORK_ERROR in stderr
    assert 'SubprocVecEnv(..., start_method="spawn")' in stderr


@pytest.mark.slow
@pytest.mark.parametrize("case", ["every_kind_used_before_a_fork", "every_kind_made_in_a_fork"])
def test_every_use_of_every_environment_fails_after_a_late_fork(run, case):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("pettingzoo")
    kinds, _ = run(case)
    assert len(kinds) >= 5
    for kind, outcomes in kinds.items():
        assert all(each.startswith(FORK_ERROR) for each in outcomes), (kind, outcomes)


@pytest.mark.slow
def test_every_environment_works_after_a_fork_before_jax(run):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("pettingzoo")
    kinds, _ = run("every_kind_made_before_a_fork")
    assert len(kinds) == 5
    assert all(set(outcomes) == {"works"} for outcomes in kinds.values()), kinds


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_detects_a_fork_before_the_import(run):
    kinds, _ = run("imported_after_a_fork")
    assert all(each.startswith(FORK_ERROR) for each in kinds["single"])


def test_detects_a_fork_of_a_fork(run):
    kinds, _ = run("grandchild")
    assert all(each.startswith(FORK_ERROR) for each in kinds["single"])


@pytest.mark.slow
def test_child_that_fails_exits(run):
    code, stderr = run("multiprocessing_child")
    assert code == 1
    assert FORK_ERROR in stderr


def test_input_errors_survive_gymnasium_pipes():
    """Gymnasium's parent process raises the type of the error with the error as the message."""
    error = pickle.loads(pickle.dumps(InputError("first\tsecond")))
    raised = type(error)(error)
    assert str(raised) == str(error) == "first\\tsecond"
    assert raised.args == error.args


def test_process_without_a_fork_raises_no_error():
    """JAX is already running in this process."""
    environment = gymnasium.make("skystack.gym:skystack/Lateral-v0")
    observation, _ = environment.reset(seed=0)
    assert np.all(np.isfinite(observation))
