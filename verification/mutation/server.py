"""A process that has imported what is slow to import, and forks to run tests: `mutation_run`'s.

    python -m verification.mutation.server MODULE...

Reads a job on each line of standard input and answers it with a line of JSON. Runs in a copy of the
project, whose sources are changed between jobs.
"""

import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

NO_TESTS = 5
"""pytest's exit code where it found none."""


class Job(NamedTuple):
    """Tests to run in a process of their own."""

    module: str
    """The module that is changed, as Python names it: it must not be imported before."""
    files: list[str]
    """The first is run first."""
    left_out: list[str]
    """Tests that are not run, by names or parts of them."""
    order: dict[str, float]
    """What tests took, where that is known: within a file the fastest are run first."""
    programs: str
    """Folder of compiled programs: read, and written where lines are noted."""
    note: str | None
    """Where to write what was found (`Noted`), if anywhere; then failures do not end the run."""
    cpu_s: int
    wall_s: float


class Noted(NamedTuple):
    """What a run of unchanged sources found."""

    lines: dict[str, list[int]]
    """The lines of each source file that were run."""
    seconds: dict[str, float]
    """What each test took of a processor: however busy it is, the same."""
    failed: list[str]


class Answer(NamedTuple):
    end: str
    """passed, failed, timed out or no tests."""
    wall_s: float
    cpu_s: float


class Plugin:
    """Orders tests, leaves some out, shares compiled programs, and notes what happens."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self.seconds: dict[str, float] = {}
        self.failed: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Generator[None, Any, Any]:
        result = yield
        if fixturedef.argname == "compile_once":  # the conftest's folder is new in each process
            import jax  # noqa: PLC0415  (the server has it already; nothing else here needs it)

            least_s = 0.1 if self._job.note else 1e9  # a killed process may leave half a file
            for name, value in (
                ("jax_compilation_cache_dir", self._job.programs),
                ("jax_persistent_cache_min_compile_time_secs", least_s),
            ):
                jax.config.update(name, value)  # type: ignore[no-untyped-call]
        return result

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        left_out = self._job.left_out
        files = {name: number for number, name in enumerate(self._job.files)}
        order = self._job.order
        items[:] = sorted(
            (item for item in items if not any(name in item.nodeid for name in left_out)),
            key=lambda item: (files[item.nodeid.partition("::")[0]], order.get(item.nodeid, 0.0)),
        )

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        began = time.process_time()
        result = yield
        self.seconds[item.nodeid] = time.process_time() - began
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)


def main(modules: Sequence[str]) -> None:
    sys.dont_write_bytecode = True  # it would be taken for that of the next change
    sys.path[:0] = [str(Path.cwd()), str(Path("src").absolute())]
    for name in modules:
        importlib.import_module(name)
    for line in sys.stdin:
        answer = _answer(Job(**json.loads(line)))
        sys.stdout.write(json.dumps(answer._asdict()) + "\n")
        sys.stdout.flush()


def _answer(job: Job) -> Answer:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    began, cpu_before = time.monotonic(), used.ru_utime + used.ru_stime
    folder = tempfile.mkdtemp(dir=".")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX is imported, but does not run here
        child = os.fork()
    if child == 0:
        _run(job, folder)
    status, parent = None, os.getppid()
    # Where the run was killed, nothing of it goes on.
    while status is None and time.monotonic() - began < job.wall_s and os.getppid() == parent:
        ended, code = os.waitpid(child, os.WNOHANG)
        status = code if ended else None
        time.sleep(0.0 if ended else 0.02)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # with what it may have started
    if status is None:
        os.waitpid(child, 0)
    shutil.rmtree(folder, ignore_errors=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Answer(
        _end(status), time.monotonic() - began, used.ru_utime + used.ru_stime - cpu_before
    )


def _end(status: int | None) -> str:
    if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return "timed out"
    code = os.waitstatus_to_exitcode(status)
    return {0: "passed", NO_TESTS: "no tests"}.get(code, "failed")


def _run(job: Job, folder: str) -> None:
    """In the child: never returns."""
    code: int = 70
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (job.cpu_s, job.cpu_s + 5))
        nowhere = os.open(os.devnull, os.O_RDWR)
        log = os.open("log.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream, target in ((0, nowhere), (1, log), (2, log)):
            os.dup2(target, stream)
        if job.module in sys.modules:
            code = NO_TESTS  # it would not be the changed one
            raise ImportError(f"{job.module} was imported before it was changed")
        code = _tested(job, folder)
    finally:
        sys.stdout.flush()
        os._exit(code)


def _tested(job: Job, folder: str) -> int:
    plugin = Plugin(job)
    quiet = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # plugins are imported before
    options = ["-n0", "-p", "no:cacheprovider", "--tb=short", f"--basetemp={folder}/tests", *quiet]
    if job.note is None:
        return int(pytest.main(["-x", *options, *job.files], plugins=[plugin]))
    import coverage  # noqa: PLC0415  (slow, and seldom needed)

    measured = coverage.Coverage(data_file=None, include=["src/skystack/*"], config_file=False)
    measured.start()
    code = int(pytest.main([*options, *job.files], plugins=[plugin]))
    measured.stop()
    data, source = measured.get_data(), Path("src").absolute()
    lines = {
        str(Path(name).relative_to(source)): list(data.lines(name) or ())
        for name in data.measured_files()
    }
    Path(job.note).write_text(json.dumps(Noted(lines, plugin.seconds, plugin.failed)._asdict()))
    return code


if __name__ == "__main__":
    main(sys.argv[1:])
