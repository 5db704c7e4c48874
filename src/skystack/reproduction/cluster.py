"""Run jobs on a Ray cluster, one core each, on any node with a free core (extra `[ray]`).

No shared file system is needed. The existing files of a job are sent with it, it works in a
temporary folder, and its files are copied to the plan's folder when it is done. Checkpoints are
copied once a minute, so that the death of a worker or an interruption costs at most a minute of
training.
"""

import logging
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import skystack
from skystack.compilation.programs import compile_for_cores
from skystack.errors import InputError, TrainingError, missing_extra
from skystack.io.files import atomic_write, make_folder
from skystack.io.locks import is_scratch
from skystack.reproduction.jobs import (
    Job,
    JobResult,
    Message,
    OnProgress,
    jobs_of,
    longest_first,
    run_job,
)
from skystack.reproduction.plan import Plan

ATTEMPTS = 5
"""How often a job is started; if its worker dies every time, the reproduction fails."""
WAIT_S = 0.2
"""The interval between two readings of the messages."""
CONNECT_TIMEOUT_S = 5.0
"""The timeout for connecting to the cluster."""

Files = dict[str, bytes]
"""The contents of files by their path relative to the plan's folder."""


def run_on_cluster(plan: Plan, report: OnProgress, address: str | None = None) -> list[JobResult]:
    """Run all seeds of all experiments, reporting progress. Results are in the plan's order.

    `address` is HOST:PORT of a running cluster. By default it is `RAY_ADDRESS`, or else the cluster
    that this machine has joined. Raises InputError if there is none or Ray is not installed,
    TrainingError for a job whose worker dies every time.
    """
    ray = _connect(address)
    running: dict[Any, Job] = {}
    try:
        return _run_all(ray, plan, report, running)
    finally:
        try:
            for reference in running:
                ray.cancel(reference, force=True)
        finally:
            ray.shutdown()


def _run_all(ray: Any, plan: Plan, report: OnProgress, running: dict[Any, Job]) -> list[JobResult]:
    """Run all jobs of a plan. `running` always holds the jobs submitted and not finished."""
    jobs = jobs_of(plan)
    this_node = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
        ray.get_runtime_context().get_node_id(), soft=False
    )
    messages = ray.util.queue.Queue(
        actor_options={"num_cpus": 0, "scheduling_strategy": this_node, "max_concurrency": 1000}
    )
    submit = ray.remote(num_cpus=1, max_retries=0)(_run).remote
    for job in longest_first(jobs):
        running[_submit(submit, job, messages)] = job
    attempts = dict.fromkeys((job.name for job in jobs), 1)
    results: dict[str, JobResult] = {}
    while running:
        ended, _ = ray.wait(list(running), timeout=WAIT_S)
        _receive_messages(messages, plan, report)
        for reference in ended:
            job = running.pop(reference)
            try:
                results[job.name], files = ray.get(reference)
                _unpack(plan, files)
            except ray.exceptions.RayTaskError as error:
                raise _job_error(job, error.cause) from None
            except ray.exceptions.RayError as error:
                if attempts[job.name] == ATTEMPTS:
                    raise _worker_died(job, error) from None
                attempts[job.name] += 1
                running[_submit(submit, job, messages)] = job
    return [results[job.name] for job in jobs]


def _connect(address: str | None) -> Any:
    if find_spec("ray") is None:
        raise missing_extra("engine ray", "ray", "ray")
    import ray  # noqa: PLC0415
    import ray.util.queue  # noqa: PLC0415
    import ray.util.scheduling_strategies  # noqa: PLC0415

    target = address or os.environ.get("RAY_ADDRESS") or "auto"
    main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGTERM)
    try:
        _check_reachable(target)
        ray.init(address=target, log_to_driver=False, logging_level=logging.CRITICAL)
    except (RuntimeError, ValueError, OverflowError, OSError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise InputError(
            f"cannot join a Ray cluster at {target} (allowed: HOST:PORT of a cluster started with "
            f"`ray start --head` that this machine has joined): {reason}"
        ) from None
    finally:
        if main:
            signal.signal(signal.SIGTERM, handler)  # Ray has replaced it
    return ray


def _check_reachable(address: str) -> None:
    """Raise OSError if nothing listens at an address; Ray itself would retry for minutes."""
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S).close()


def _submit(submit: Callable[..., Any], job: Job, messages: Any) -> Any:
    return submit(job, _pack(job.plan, job.folders), messages, skystack.__version__)


def _run(job: Job, files: Files, messages: Any, version: str) -> tuple[JobResult, Files]:
    """Run a job on a worker, starting from its existing files. Returns all its files."""
    if skystack.__version__ != version:
        raise InputError(
            f"a node of the cluster has skystack {skystack.__version__} (allowed: {version})"
        )
    compile_for_cores(1)
    with tempfile.TemporaryDirectory(prefix="skystack-") as folder:
        local = job._replace(plan=replace(job.plan, out=Path(folder)))
        _unpack(local.plan, files)
        result = run_job(local, partial(_send_message, _Checkpoint(local), messages))
        return result, _pack(local.plan, local.folders)


class _Checkpoint:
    """The checkpoint of a training, if there is a new one."""

    def __init__(self, job: Job) -> None:
        self._job, self._sent_ns = job, 0

    def new_files(self) -> Files:
        """The files of a new checkpoint, and the metrics, which must cover its updates."""
        training = self._job.plan.training(self._job.name)
        saved = sorted((training / "checkpoint").glob("*"))
        newest = max((path.stat().st_mtime_ns for path in saved), default=0)
        if newest == self._sent_ns:
            return {}
        self._sent_ns = newest
        # The metrics are read last, so that they cover the checkpoint.
        others = [training / "config.toml", training / "metrics.jsonl"]
        return _read(self._job.plan, [*saved, *others])


def _send_message(checkpoint: _Checkpoint, messages: Any, message: Message) -> None:
    messages.put((message, checkpoint.new_files()))


def _receive_messages(messages: Any, plan: Plan, report: OnProgress) -> None:
    for message, files in messages.get_nowait_batch(messages.qsize()):
        _unpack(plan, files)
        report(*message)


def _pack(plan: Plan, folders: Iterable[Path]) -> Files:
    paths = (path for folder in folders for path in sorted(folder.rglob("*")))
    return _read(plan, (path for path in paths if path.is_file() and not is_scratch(path)))


def _read(plan: Plan, paths: Iterable[Path]) -> Files:
    return {str(path.relative_to(plan.out)): path.read_bytes() for path in paths}


def _unpack(plan: Plan, files: Files) -> None:
    # A checkpoint is written after the metrics, which must cover its updates.
    for name, data in sorted(files.items(), key=lambda file: "/checkpoint/" in file[0]):
        path = plan.out / name
        make_folder(path.parent)
        atomic_write(path, data)


def _job_error(job: Job, error: Exception) -> Exception:
    """The exception to raise here for a job that failed on a worker."""
    if isinstance(error, InputError | TrainingError):
        return error
    reason = str(error).strip().rpartition("\n")[2]
    return TrainingError(f"{job.name}: failed on its worker: {type(error).__name__}: {reason}")


def _worker_died(job: Job, error: Exception) -> TrainingError:
    reason = str(error).strip().partition("\n")[0]
    return TrainingError(f"{job.name}: its worker died {ATTEMPTS} times: {reason}")
