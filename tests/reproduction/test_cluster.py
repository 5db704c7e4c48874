"""Jobs on a real Ray cluster of two nodes on this machine, one of whose workers is killed."""

import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from skystack.errors import InputError, TrainingError
from skystack.learning.experiment import load_experiment
from skystack.learning.run import TrainingProgress
from skystack.reproduction import cluster
from skystack.reproduction.jobs import Job, trained_once
from skystack.reproduction.plan import Plan
from skystack.reproduction.processes import run_in_processes
from tests.waiting import HANGS_S

pytest.importorskip("ray")

SMALL = ("ppo.environments=8", "ppo.steps=32", "ppo.minibatch=64", "ppo.epochs=2")


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("lateral", (*SMALL, "ppo.total_steps=20480"))


def plan_of(experiment, out, seeds=2):
    return Plan((experiment,), seeds, 3, out, False, "command")


@pytest.fixture(scope="module")
def nodes():
    """A head and a second node, a core each; gives its address and the second one's process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folder = tempfile.mkdtemp(prefix="ray-", dir="/tmp")  # the paths of sockets must be short
    head = ["--head", f"--port={port}", f"--temp-dir={folder}", "--include-dashboard=false"]
    with running(head), running([f"--address=127.0.0.1:{port}"]) as second:
        wait_for_nodes(f"127.0.0.1:{port}", 2)
        yield f"127.0.0.1:{port}", second.pid
    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def running(arguments):
    """A node for as long as it is needed."""
    ray = Path(sys.executable).with_name("ray")
    same = ["--num-cpus=1", "--node-ip-address=127.0.0.1", "--object-store-memory=100000000"]
    # Ray gives way to other programs unless told not to.
    settings = {"RAY_worker_niceness": "0", "RAY_USAGE_STATS_ENABLED": "0"}
    node = subprocess.Popen(
        [ray, "start", "--block", *same, *arguments],
        env=os.environ | settings,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield node
    finally:
        node.terminate()
        node.wait(timeout=HANGS_S)


def wait_for_nodes(address, count):
    import ray

    until = time.monotonic() + HANGS_S
    while time.monotonic() < until:
        with suppress(OSError):
            cluster._check_reachable(address)
            ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
            found = len(ray.nodes())
            ray.shutdown()
            if found == count:
                return
        time.sleep(0.5)
    raise AssertionError("the cluster did not start")


def worker_of(node):
    """The process that runs a job below a node's."""
    below = {node}
    processes = sorted(Path("/proc").glob("[0-9]*"), key=lambda path: int(path.name))
    for path in processes:  # parents first
        with suppress(OSError):
            if int((path / "stat").read_text().rpartition(")")[2].split()[1]) in below:
                below.add(int(path.name))
                if b"ray::_run" in (path / "cmdline").read_bytes():
                    return int(path.name)
    return None


def weights(plan, seed):
    return (plan.training(f"lateral-s{seed}") / "policy.safetensors").read_bytes()


def without_times(done):
    rows = [{**flown.row, "wall_s": 0.0} for flown in done.flown]
    return done.train["seed"], done.train["steps"], rows


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::FutureWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_cluster_makes_what_processes_make_though_a_worker_is_killed(nodes, experiment, tmp_path):
    address, second = nodes
    here = plan_of(experiment, tmp_path / "here")
    expected = run_in_processes(here, lambda name, progress: None)

    killed, heard = [], []
    away = plan_of(experiment, tmp_path / "away")

    def report(name, progress):
        heard.append((name, progress.steps))
        worker = worker_of(second)
        if not killed and worker is not None and progress.steps >= 2048:
            killed.append(worker)
            os.kill(worker, signal.SIGKILL)

    done = cluster.run_on_cluster(away, report, address)
    assert len(killed) == 1
    assert {steps for name, steps in heard if name == "lateral-s0"} >= {256, 20480}
    assert [weights(away, seed) for seed in (0, 1)] == [weights(here, seed) for seed in (0, 1)]
    assert [without_times(each) for each in done] == [without_times(each) for each in expected]

    # All of it is kept, and what is missing is made again.
    (away.training("lateral-s1") / "policy.json").unlink()
    again = cluster.run_on_cluster(away, lambda name, progress: None, address)
    assert [len(each.kept) for each in again] == [3, 2]
    assert weights(away, 1) == weights(here, 1)


def test_what_an_interrupted_run_left_is_sent_along(nodes, experiment, tmp_path):
    plan = plan_of(experiment, tmp_path, seeds=1)

    def interrupt(progress):
        if progress.steps == 4096:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trained_once(plan, experiment, 0, interrupt)
    heard = []
    cluster.run_on_cluster(plan, lambda name, progress: heard.append(progress.steps), nodes[0])
    assert (heard[0], heard[-1]) == (4096 + 256, 20480)


def test_a_failure_on_a_worker_is_told_as_here(nodes, tmp_path):
    large = [f"ppo.{name}=1e6" for name in ("learning_rate", "reward_scale", "max_gradient_norm")]
    changes = (*SMALL, *large, "ppo.adam_epsilon=1e-30", "ppo.total_steps=20000")
    plan = plan_of(load_experiment("lateral", changes), tmp_path, seeds=1)
    with pytest.raises(TrainingError, match="lateral, seed 0: value_loss is not finite"):
        cluster.run_on_cluster(plan, lambda name, progress: None, nodes[0])


def test_each_checkpoint_is_sent_once(experiment, tmp_path):
    job = Job(plan_of(experiment, tmp_path), experiment, 0)
    new_files = cluster._Checkpoint(job).new_files
    assert new_files() == {}
    folder = job.plan.training(job.name)
    (folder / "checkpoint").mkdir(parents=True)
    written = {"checkpoint/learner.safetensors": b"l", "config.toml": b"c", "metrics.jsonl": b"m"}
    for name, data in written.items():
        (folder / name).write_bytes(data)
    assert new_files() == {f"train/lateral-s0/{name}": data for name, data in written.items()}
    assert new_files() == {}


def test_a_checkpoint_that_comes_back_lands_after_its_metrics(experiment, tmp_path, monkeypatch):
    plan = plan_of(experiment, tmp_path)
    names = ["checkpoint/learner.safetensors", "config.toml", "metrics.jsonl"]
    files = {f"train/lateral-s0/{name}": name.encode() for name in names}
    progress = TrainingProgress(256, 1024, 1.0, {})
    sent, heard, written = (
        [(("lateral-s0", progress), files), (("lateral-s1", progress), {})],
        [],
        [],
    )
    queue = SimpleNamespace(qsize=lambda: 2, get_nowait_batch=lambda count: sent[:count])
    write = cluster.atomic_write
    monkeypatch.setattr(
        cluster, "atomic_write", lambda path, data: (written.append(path.name), write(path, data))
    )
    cluster._receive_messages(queue, plan, lambda name, progress: heard.append(name))
    assert heard == ["lateral-s0", "lateral-s1"]
    assert written == ["config.toml", "metrics.jsonl", "learner.safetensors"]
    assert cluster._pack(plan, [tmp_path]) == files


def test_a_job_whose_worker_always_dies_is_given_up(nodes, experiment, tmp_path, monkeypatch):
    fatal = {"__name__": "__main__"}  # sent whole, since no worker could import it
    exec("def die(*given):\n    import os\n    os.kill(os.getpid(), 9)", fatal)
    monkeypatch.setattr(cluster, "_run", fatal["die"])
    monkeypatch.setattr(cluster, "ATTEMPTS", 2)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(TrainingError, match="lateral-s0: its worker died 2 times"):
        cluster.run_on_cluster(plan_of(experiment, tmp_path, seeds=1), print, nodes[0])
    assert signal.getsignal(signal.SIGTERM) is before


def test_whatever_else_fails_on_a_worker_is_one_line(nodes, experiment, tmp_path, monkeypatch):
    fatal = {"__name__": "__main__"}
    exec("def fail(*given):\n    raise ImportError('no skystack here')", fatal)
    monkeypatch.setattr(cluster, "_run", fatal["fail"])
    with pytest.raises(
        TrainingError, match=r"^lateral-s0: failed .* ImportError: no skystack here$"
    ):
        cluster.run_on_cluster(plan_of(experiment, tmp_path, seeds=1), print, nodes[0])


@pytest.mark.parametrize("address", ["127.0.0.1:9", "nonsense", "no.such.host.invalid:6379"])
def test_where_no_cluster_is(address, experiment, tmp_path):
    with pytest.raises(InputError, match=f"cannot join a Ray cluster at {address}"):
        cluster.run_on_cluster(plan_of(experiment, tmp_path), print, address)


def test_a_node_with_another_version_is_refused(experiment, tmp_path):
    job = Job(plan_of(experiment, tmp_path), experiment, 0)
    with pytest.raises(InputError, match=r"has skystack .* \(allowed: 9\.9\)"):
        cluster._run(job, {}, None, "9.9")
