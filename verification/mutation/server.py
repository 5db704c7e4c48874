"""The server of `verification.mutation.run`: imports slow modules once, and forks to run tests.

    python -m verification.mutation.server MODULE...

Reads one job per line of standard input and answers each with one line of JSON. Runs in a copy of
the project, whose sources are changed between jobs.
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
"""pytest's exit code if it found no tests."""


class Job(NamedTuple):
    """Tests to run in a forked process."""

    module: str
    """The changed module, as a dotted name; it must not be imported before."""
    files: list[str]
    """The test files, in the order in which they are run."""
    left_out: list[str]
    """Tests that are not run, by their names or parts of these."""
    order: dict[str, float]
    """Known durations of tests; within a file the fastest are run first."""
    programs: str
    """The cache folder of compiled programs, written only if lines are recorded."""
    record: str | None
    """The file for the recorded lines (`Recorded`), if any; then failures do not end the run."""
    cpu_s: int
    wall_s: float


class Recorded(NamedTuple):
    """The record of a run with unchanged sources."""

    lines: dict[str, list[int]]
    """The executed lines of each source file."""
    seconds: dict[str, float]
    """The processor time of each test, which does not depend on other work on the machine."""
    failed: list[str]


class Answer(NamedTuple):
    end: str
    """passed, failed, timed out or no tests."""
    wall_s: float
    cpu_s: float


class Plugin:
    """Orders tests, leaves some out, shares compiled programs, and records results."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self.seconds: dict[str, float] = {}
        self.failed: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Generator[None, Any, Any]:
        result = yield
        if fixturedef.argname == "compile_once":  # conftest's cache folder is new in each process
            import jax  # noqa: PLC0415  (the server has imported it already)

            least_s = 0.1 if self._job.record else 1e9  # a killed process may leave half a file
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
        started = time.process_time()
        result = yield
        self.seconds[item.nodeid] = time.process_time() - started
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)


def main(modules: Sequence[str]) -> None:
    sys.dont_write_bytecode = True  # it would be reused after the next change
    sys.path[:0] = [str(Path.cwd()), str(Path("src").absolute())]
    for name in modules:
        importlib.import_module(name)
    for line in sys.stdin:
        answer = _answer(Job(**json.loads(line)))
        sys.stdout.write(json.dumps(answer._asdict()) + "\n")
        sys.stdout.flush()


def _answer(job: Job) -> Answer:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    started, cpu_before = time.monotonic(), used.ru_utime + used.ru_stime
    folder = tempfile.mkdtemp(dir=".")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX warns about forks, but has not started here
        child = os.fork()
    if child == 0:
        _run(job, folder)
    status, parent = None, os.getppid()
    # Stop waiting, and kill the child, if this server's parent has died.
    while status is None and time.monotonic() - started < job.wall_s and os.getppid() == parent:
        ended, code = os.waitpid(child, os.WNOHANG)
        status = code if ended else None
        time.sleep(0.0 if ended else 0.02)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # including processes that it started
    if status is None:
        os.waitpid(child, 0)
    shutil.rmtree(folder, ignore_errors=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Answer(
        _end(status), time.monotonic() - started, used.ru_utime + used.ru_stime - cpu_before
    )


def _end(status: int | None) -> str:
    if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return "timed out"
    code = os.waitstatus_to_exitcode(status)
    return {0: "passed", NO_TESTS: "no tests"}.get(code, "failed")


def _run(job: Job, folder: str) -> None:
    """Run the tests in the child process; never returns."""
    code: int = 70
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (job.cpu_s, job.cpu_s + 5))
        devnull = os.open(os.devnull, os.O_RDWR)
        log = os.open("log.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream, target in ((0, devnull), (1, log), (2, log)):
            os.dup2(target, stream)
        if job.module in sys.modules:
            code = NO_TESTS  # the tests would not see the change
            raise ImportError(f"{job.module} was imported before it was changed")
        code = _run_tests(job, folder)
    finally:
        sys.stdout.flush()
        os._exit(code)


def _run_tests(job: Job, folder: str) -> int:
    plugin = Plugin(job)
    quiet = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # plugins are already imported
    options = ["-n0", "-p", "no:cacheprovider", "--tb=short", f"--basetemp={folder}/tests", *quiet]
    if job.record is None:
        return int(pytest.main(["-x", *options, *job.files], plugins=[plugin]))
    import coverage  # noqa: PLC0415  (slow, and rarely needed)

    measured = coverage.Coverage(data_file=None, include=["src/skystack/*"], config_file=False)
    measured.start()
    code = int(pytest.main([*options, *job.files], plugins=[plugin]))
    measured.stop()
    data, source = measured.get_data(), Path("src").absolute()
    lines = {
        str(Path(name).relative_to(source)): list(data.lines(name) or ())
        for name in data.measured_files()
    }
    recorded = Recorded(lines, plugin.seconds, plugin.failed)
    Path(job.record).write_text(json.dumps(recorded._asdict()))
    return code


if __name__ == "__main__":
    main(sys.argv[1:])
