"""Jobs on a Ray cluster, a core each, wherever there is one free (extra `[ray]`).

Nothing is shared but what Ray carries: a job takes along the files that its piece has already,
works in a folder of its own, and its files come back into the folder of the plan when it is done.
Checkpoints come back once a minute, so that a worker that dies or an interruption costs no more of
a training.
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
from skystack.compilation.programs import compile_for_one_core
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
"""How often a job is begun before workers that die under it are taken for its fault."""
WAIT_S = 0.2
KNOCK_S = 5.0

Files = dict[str, bytes]
"""By path below the folder of the plan."""


def run_on_cluster(plan: Plan, report: OnProgress, address: str | None = None) -> list[JobResult]:
    """All seeds of all experiments, in order of the plan; their progress goes to `report`.

    `address` is that of a running cluster (HOST:PORT); None: what `RAY_ADDRESS` names, or the one
    that this machine belongs to. Raises InputError when there is none or Ray is not installed,
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
    """`running` holds what the cluster works on, at any time."""
    jobs = jobs_of(plan)
    here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
        ray.get_runtime_context().get_node_id(), soft=False
    )
    messages = ray.util.queue.Queue(
        actor_options={"num_cpus": 0, "scheduling_strategy": here, "max_concurrency": 1000}
    )
    submit = ray.remote(num_cpus=1, max_retries=0)(_run).remote
    for job in longest_first(jobs):
        running[_submit(submit, job, messages)] = job
    attempts = dict.fromkeys((job.name for job in jobs), 1)
    done: dict[str, JobResult] = {}
    while running:
        ended, _ = ray.wait(list(running), timeout=WAIT_S)
        _hear(messages, plan, report)
        for reference in ended:
            job = running.pop(reference)
            try:
                done[job.name], files = ray.get(reference)
                _unpack(plan, files)
            except ray.exceptions.RayTaskError as error:
                raise _told(job, error.cause) from None
            except ray.exceptions.RayError as error:
                if attempts[job.name] == ATTEMPTS:
                    raise _given_up(job, error) from None
                attempts[job.name] += 1
                running[_submit(submit, job, messages)] = job
    return [done[job.name] for job in jobs]


def _connect(address: str | None) -> Any:
    if find_spec("ray") is None:
        raise missing_extra("engine ray", "ray", "ray")
    import ray  # noqa: PLC0415
    import ray.util.queue  # noqa: PLC0415
    import ray.util.scheduling_strategies  # noqa: PLC0415

    wanted = address or os.environ.get("RAY_ADDRESS") or "auto"
    main = threading.current_thread() is threading.main_thread()
    terminated = signal.getsignal(signal.SIGTERM)
    try:
        _knock(wanted)
        ray.init(address=wanted, log_to_driver=False, logging_level=logging.CRITICAL)
    except (RuntimeError, ValueError, OverflowError, OSError) as error:
        reason = str(error).strip().partition("\n")[0]
        raise InputError(
            f"cannot join a Ray cluster at {wanted} (allowed: HOST:PORT of one started with "
            f"`ray start --head` and joined by this machine): {reason}"
        ) from None
    finally:
        if main:
            signal.signal(signal.SIGTERM, terminated)  # Ray sets its own
    return ray


def _knock(address: str) -> None:
    """Raise OSError where nobody listens; Ray itself would go on trying for minutes."""
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host, int(port)), timeout=KNOCK_S).close()


def _submit(submit: Callable[..., Any], job: Job, messages: Any) -> Any:
    return submit(job, _pack(job.plan, job.folders), messages, skystack.__version__)


def _run(job: Job, given: Files, messages: Any, version: str) -> tuple[JobResult, Files]:
    """On a worker."""
    if skystack.__version__ != version:
        raise InputError(
            f"a node of the cluster has skystack {skystack.__version__} (allowed: {version})"
        )
    compile_for_one_core()
    with tempfile.TemporaryDirectory(prefix="skystack-") as folder:
        away = job._replace(plan=replace(job.plan, out=Path(folder)))
        _unpack(away.plan, given)
        done = run_job(away, partial(_tell, _Checkpoint(away), messages))
        return done, _pack(away.plan, away.folders)


class _Checkpoint:
    """The checkpoint of a training, when there is a newer one."""

    def __init__(self, job: Job) -> None:
        self._job, self._seen = job, 0

    def news(self) -> Files:
        """With the metrics, read after it: they hold at least its updates."""
        training = self._job.plan.training(self._job.name)
        saved = sorted((training / "checkpoint").glob("*"))
        newest = max((path.stat().st_mtime_ns for path in saved), default=0)
        if newest == self._seen:
            return {}
        self._seen = newest
        beside = [training / "config.toml", training / "metrics.jsonl"]
        return _read(self._job.plan, [*saved, *beside])


def _tell(checkpoint: _Checkpoint, messages: Any, message: Message) -> None:
    messages.put((message, checkpoint.news()))


def _hear(messages: Any, plan: Plan, report: OnProgress) -> None:
    for message, files in messages.get_nowait_batch(messages.qsize()):
        _unpack(plan, files)
        report(*message)


def _pack(plan: Plan, folders: Iterable[Path]) -> Files:
    found = (path for folder in folders for path in sorted(folder.rglob("*")))
    return _read(plan, (path for path in found if path.is_file() and not is_scratch(path)))


def _read(plan: Plan, paths: Iterable[Path]) -> Files:
    return {str(path.relative_to(plan.out)): path.read_bytes() for path in paths}


def _unpack(plan: Plan, files: Files) -> None:
    # A checkpoint after its metrics, which must hold at least its updates.
    for name, data in sorted(files.items(), key=lambda file: "/checkpoint/" in file[0]):
        path = plan.out / name
        make_folder(path.parent)
        atomic_write(path, data)


def _told(job: Job, error: Exception) -> Exception:
    """What a job failed of, as it would be told here."""
    if isinstance(error, InputError | TrainingError):
        return error
    reason = str(error).strip().rpartition("\n")[2]
    return TrainingError(f"{job.name}: failed on its worker: {type(error).__name__}: {reason}")


def _given_up(job: Job, error: Exception) -> TrainingError:
    reason = str(error).strip().partition("\n")[0]
    return TrainingError(f"{job.name}: its worker died {ATTEMPTS} times: {reason}")
