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
from skystack.learning.progress import TrainingProgress
from skystack.reproduction import cluster
from skystack.reproduction.jobs import Job, train_or_load
from skystack.reproduction.plan import Plan
from skystack.reproduction.processes import run_in_processes
from tests.waiting import TIMEOUT_S

pytest.importorskip("ray")

SMALL = ("ppo.environments=8", "ppo.steps=32", "ppo.minibatch=64", "ppo.epochs=2")


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("lateral", (*SMALL, "ppo.total_steps=20480"))


def plan_of(experiment, out, seeds=2):
    return Plan((experiment,), seeds, 3, out, False, "command")


@pytest.fixture(scope="module")
def nodes():
    """A head and a second node with one core each: the address, and the second node's process."""
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
    """A Ray node that runs inside the context."""
    ray = Path(sys.executable).with_name("ray")
    options = ["--num-cpus=1", "--node-ip-address=127.0.0.1", "--object-store-memory=100000000"]
    # By default, Ray lowers the priority of its workers.
    settings = {"RAY_worker_niceness": "0", "RAY_USAGE_STATS_ENABLED": "0"}
    node = subprocess.Popen(
        [ray, "start", "--block", *options, *arguments],
        env=os.environ | settings,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield node
    finally:
        node.terminate()
        node.wait(timeout=TIMEOUT_S)


def wait_for_nodes(address, count):
    import ray

    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
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
    """The process below a node's that runs a job; None if there is none."""
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


def without_times(result):
    rows = [{**flown.row, "wall_s": 0.0} for flown in result.flown]
    train = result.train or {"seed": None, "steps": None}
    return train["seed"], train["steps"], rows


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::FutureWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_cluster_gives_the_same_results_if_a_worker_is_killed(nodes, experiment, tmp_path):
    address, second = nodes
    local = plan_of(experiment, tmp_path / "local")
    expected = run_in_processes(local, lambda name, progress: None)

    killed, reported = [], []
    remote = plan_of(experiment, tmp_path / "remote")

    def report(name, progress):
        if isinstance(progress, str):  # a phase
            return
        reported.append((name, progress.steps))
        worker = worker_of(second)
        if not killed and worker is not None and progress.steps >= 2048:
            killed.append(worker)
            os.kill(worker, signal.SIGKILL)

    results = cluster.run_on_cluster(remote, report, address)
    assert len(killed) == 1
    assert {steps for name, steps in reported if name == "lateral-s0"} >= {256, 20480}
    assert [weights(remote, seed) for seed in (0, 1)] == [weights(local, seed) for seed in (0, 1)]
    assert [without_times(each) for each in results] == [without_times(each) for each in expected]

    # Finished pieces are cached, and the missing one is repeated.
    (remote.training("lateral-s1") / "policy.json").unlink()
    again = cluster.run_on_cluster(remote, lambda name, progress: None, address)
    assert [len(each.kept) for each in again] == [3, 2, 1]
    assert weights(remote, 1) == weights(local, 1)


@pytest.mark.slow
def test_resumes_an_interrupted_training(nodes, experiment, tmp_path):
    plan = plan_of(experiment, tmp_path, seeds=1)

    def interrupt(progress):
        if progress.steps == 4096:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_or_load(plan, experiment, 0, interrupt)
    reported = []

    def report(name, progress):
        if not isinstance(progress, str):  # a phase
            reported.append(progress.steps)

    cluster.run_on_cluster(plan, report, nodes[0])
    assert (reported[0], reported[-1]) == (4096 + 256, 20480)


@pytest.mark.slow
def test_training_error_on_a_worker_is_raised_here(nodes, tmp_path):
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


def test_checkpoint_is_written_after_its_metrics(experiment, tmp_path, monkeypatch):
    plan = plan_of(experiment, tmp_path)
    names = ["checkpoint/learner.safetensors", "config.toml", "metrics.jsonl"]
    files = {f"train/lateral-s0/{name}": name.encode() for name in names}
    progress = TrainingProgress(256, 1024, 1.0, {})
    sent, reported, written = (
        [(("lateral-s0", progress), files), (("lateral-s1", progress), {})],
        [],
        [],
    )
    queue = SimpleNamespace(qsize=lambda: 2, get_nowait_batch=lambda count: sent[:count])
    write = cluster.atomic_write
    monkeypatch.setattr(
        cluster, "atomic_write", lambda path, data: (written.append(path.name), write(path, data))
    )
    cluster._receive_messages(queue, plan, lambda name, progress: reported.append(name))
    assert reported == ["lateral-s0", "lateral-s1"]
    assert written == ["config.toml", "metrics.jsonl", "learner.safetensors"]
    assert cluster._pack(plan, [tmp_path]) == files


@pytest.mark.slow
def test_gives_up_a_job_whose_worker_always_dies(nodes, experiment, tmp_path, monkeypatch):
    fatal = {"__name__": "__main__"}  # pickled by value, because workers cannot import it
    exec("def die(*given):\n    import os\n    os.kill(os.getpid(), 9)", fatal)
    monkeypatch.setattr(cluster, "_run", fatal["die"])
    monkeypatch.setattr(cluster, "ATTEMPTS", 2)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(TrainingError, match="its worker died 2 times"):
        cluster.run_on_cluster(plan_of(experiment, tmp_path, seeds=1), print, nodes[0])
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.slow
def test_other_error_on_a_worker_is_one_line(nodes, experiment, tmp_path, monkeypatch):
    fatal = {"__name__": "__main__"}
    exec("def fail(*given):\n    raise ImportError('no skystack here')", fatal)
    monkeypatch.setattr(cluster, "_run", fatal["fail"])
    either = "(lateral-s0|do-nothing-lateral)"  # the job that ends first
    with pytest.raises(TrainingError, match=f"^{either}: failed .* ImportError: no skystack here$"):
        cluster.run_on_cluster(plan_of(experiment, tmp_path, seeds=1), print, nodes[0])


@pytest.mark.parametrize("address", ["127.0.0.1:9", "nonsense", "no.such.host.invalid:6379"])
def test_rejects_addresses_without_a_cluster(address, experiment, tmp_path):
    with pytest.raises(InputError, match=f"cannot join a Ray cluster at {address}"):
        cluster.run_on_cluster(plan_of(experiment, tmp_path), print, address)


def test_rejects_nodes_with_another_version(experiment, tmp_path):
    job = Job(plan_of(experiment, tmp_path), experiment, 0)
    with pytest.raises(InputError, match=r"has skystack .* \(allowed: 9\.9\)"):
        cluster._run(job, {}, None, "9.9")
