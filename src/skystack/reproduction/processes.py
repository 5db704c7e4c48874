"""Run jobs in separate processes on this machine, one per core."""

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.managers import SyncManager
from threading import Thread
from typing import Any

from skystack.compilation.cores import cores
from skystack.errors import InputError, TrainingError
from skystack.io.locks import locked_folder
from skystack.io.parents import end_with_parent
from skystack.io.signals import starting_processes, wait_for
from skystack.reproduction.jobs import Job, JobResult, OnProgress, jobs_of, longest_first, run_job
from skystack.reproduction.plan import Plan

Messages = Any
"""A message queue of `multiprocessing.Manager`, whose proxy is not a `Queue`."""


def run_in_processes(plan: Plan, report: OnProgress) -> list[JobResult]:
    """Run all seeds of all experiments, reporting progress. Results are in the plan's order."""
    jobs = jobs_of(plan)
    context = multiprocessing.get_context("spawn")
    manager = SyncManager(ctx=context)
    with starting_processes():
        manager.start(end_with_parent)
    with _cleanup_on_failure(jobs), manager:
        messages: Messages = manager.Queue()
        free_cores = manager.Queue()
        for core in cores():
            free_cores.put(core)
        listener = Thread(target=_listen, args=(messages, report), daemon=True)
        listener.start()
        pool = ProcessPoolExecutor(
            min(len(cores()), len(jobs)), context, initializer=_pin, initargs=(free_cores,)
        )
        try:
            with starting_processes():
                futures = {
                    job.name: pool.submit(_run, job, messages) for job in longest_first(jobs)
                }
            return [wait_for(futures[job.name]) for job in jobs]
        except BrokenProcessPool:
            raise TrainingError(
                "a worker process was killed, perhaps because memory ran out; finished work is "
                "cached: run the same command again to resume"
            ) from None
        except BaseException:
            stop_workers()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
            messages.put(None)
            listener.join(timeout=5.0)


def stop_workers() -> None:
    """Terminate the workers: their results are no longer needed."""
    for child in multiprocessing.active_children():
        if not child.name.startswith("SyncManager"):
            child.terminate()


@contextmanager
def _cleanup_on_failure(jobs: Sequence[Job]) -> Iterator[None]:
    """On failure inside the context, delete the temporary files of its workers, which have ended.

    `locked_folder` deletes them when it locks a folder. A folder that another process has locked is
    left alone.
    """
    try:
        yield
    except BaseException:
        for folder in (each for job in jobs for each in job.folders if each.exists()):
            with suppress(InputError), locked_folder(folder, below=("checkpoint",)):
                pass
        raise


def _pin(free_cores: Any) -> None:
    """Pin this process to one core: two trainings on the same core slow each other down."""
    end_with_parent()
    core = free_cores.get()
    if core is not None:
        os.sched_setaffinity(0, {core})


def _listen(messages: Messages, report: OnProgress) -> None:
    while (message := _next(messages)) is not None:
        report(*message)


def _next(messages: Messages) -> Any:
    """The next message; None after the last one."""
    try:
        return messages.get()
    except (EOFError, OSError):  # the queue's process may have ended after an interruption
        return None


def _run(job: Job, messages: Messages) -> JobResult:
    return run_job(job, messages.put)
