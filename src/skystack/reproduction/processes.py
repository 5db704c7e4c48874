"""Jobs in processes of their own on this machine, one a core."""

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing.managers import SyncManager
from threading import Thread
from typing import Any

from skystack.cores import cores
from skystack.errors import InputError, TrainingError
from skystack.files import alone_in
from skystack.reproduction.jobs import Done, Job, Report, jobs_of, longest_first, run_job
from skystack.reproduction.plan import Plan
from skystack.signals import starting_processes, wait_for

Messages = Any
"""A queue of `multiprocessing.Manager` (its proxy is no `Queue`) for messages."""


def run_in_processes(plan: Plan, report: Report) -> list[Done]:
    """All seeds of all experiments, in order of the plan; their progress goes to `report`."""
    jobs = jobs_of(plan)
    context = multiprocessing.get_context("spawn")
    manager = SyncManager(ctx=context)
    with starting_processes():
        manager.start(_end_with_parent)
    with manager:
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
                "a process that trains was killed, perhaps for want of memory; what is finished is "
                "kept, and the same command goes on"
            ) from None
        except BaseException:
            _stop_workers()
            pool.shutdown(wait=True, cancel_futures=True)  # they hold the locks until they end
            _delete_half_written(jobs)
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
            messages.put(None)
            listener.join(timeout=5.0)


def _stop_workers() -> None:
    """Terminate the workers: nobody will read their results."""
    for child in multiprocessing.active_children():
        if not child.name.startswith("SyncManager"):
            child.terminate()


def _delete_half_written(jobs: Sequence[Job]) -> None:
    """Delete temporary files of stopped workers: `alone_in` does so when it locks a folder."""
    for folder in (each for job in jobs for each in job.folders if each.exists()):
        with suppress(InputError), alone_in(folder, below=("checkpoint",)):
            pass


def _pin(free_cores: Any) -> None:
    """One process, one core: two learners on the same cores slow each other down."""
    _end_with_parent()
    core = free_cores.get()
    if core is not None:
        os.sched_setaffinity(0, {core})


def _end_with_parent() -> None:
    """A parent that is killed cannot stop its children: left alone they would hold the folders."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        Thread(target=_outlive, args=(parent,), daemon=True).start()


def _outlive(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _listen(messages: Messages, report: Report) -> None:
    with suppress(EOFError, OSError):  # after an interruption the manager may be gone
        while (message := messages.get()) is not None:
            report(*message)


def _run(job: Job, messages: Messages) -> Done:
    return run_job(job, messages.put)
