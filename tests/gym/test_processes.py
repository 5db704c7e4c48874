"""Environments in several processes: they work, or say in one line why not, and never hang."""

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
from tests.waiting import HANGS_S

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")

SCRIPT = Path(__file__).with_name("forking.py")
REFUSED = "InputError: JAX was started before this process was forked"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs a case in a process of its own: (its result, what it printed as errors)."""
    kept = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path_factory.mktemp("compiled")),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }

    def case(name):
        command = [sys.executable, str(SCRIPT), name]
        done = subprocess.run(
            command,
            env=os.environ | kept,
            capture_output=True,
            text=True,
            timeout=HANGS_S,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1]), done.stderr

    return case


@pytest.mark.parametrize("case", ["async_forked", "async_spawned", "async_forkserver"])
def test_asynchronous_environments_are_the_synchronous_ones(run, case):
    """By default, too, where nothing has used JAX before."""
    assert run(case)[0] is True


def test_an_asynchronous_environment_is_refused_in_the_parent(run):
    (kind, message), _ = run("async_forked_too_late")
    assert kind == "InputError"
    assert 'AsyncVectorEnv(..., context="spawn")' in message
    assert "\n" not in message


def test_stable_baselines3_by_fork(run):
    pytest.importorskip("stable_baselines3")
    assert run("sb3_forked")[0] is True
    result, printed = run("sb3_forked_too_late")
    assert result == "ended"
    assert REFUSED in printed
    assert 'SubprocVecEnv(..., start_method="spawn")' in printed


@pytest.mark.parametrize("case", ["every_kind_used_before_a_fork", "every_kind_made_in_a_fork"])
def test_every_use_of_every_kind_is_refused_after_a_late_fork(run, case):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("pettingzoo")
    kinds, _ = run(case)
    assert len(kinds) >= 5
    for kind, outcomes in kinds.items():
        assert all(each.startswith(REFUSED) for each in outcomes), (kind, outcomes)


def test_every_kind_works_after_a_fork_before_jax(run):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("pettingzoo")
    kinds, _ = run("every_kind_made_before_a_fork")
    assert len(kinds) == 5
    assert all(set(outcomes) == {"works"} for outcomes in kinds.values()), kinds


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_a_fork_before_the_import_is_noticed(run):
    kinds, _ = run("imported_after_a_fork")
    assert all(each.startswith(REFUSED) for each in kinds["single"])


def test_a_forked_copy_of_a_forked_copy(run):
    kinds, _ = run("grandchild")
    assert all(each.startswith(REFUSED) for each in kinds["single"])


def test_a_child_that_is_refused_ends(run):
    code, printed = run("multiprocessing_child")
    assert code == 1
    assert REFUSED in printed


def test_any_bad_input_survives_gymnasiums_pipe():
    """Its parent raises the error's type with the error itself as the message."""
    error = pickle.loads(pickle.dumps(InputError("first\tsecond")))
    raised = type(error)(error)
    assert str(raised) == str(error) == "first\\tsecond"
    assert raised.args == error.args


def test_a_process_without_a_fork_is_never_refused():
    """This one, in which JAX has long been running."""
    environment = gymnasium.make("skystack.gym:skystack/Lateral-v0")
    observation, _ = environment.reset(seed=0)
    assert np.all(np.isfinite(observation))
