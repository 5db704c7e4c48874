"""Mutation testing: make small changes to the code; after each one a test must fail.

    python -m verification.mutation.run --package tasks --sample 150 --seed 1 --results tasks.jsonl

Needs the extras `mutation` (cosmic-ray, which makes most changes) and `test`. Only copies of the
project are changed. For each change, the tests nearest to its module that execute the changed lines
are run (see `parts`), the fastest first, until one fails. If no test executes them, the change
counts as survived.

Results are lines of JSON. With the same results file, only missing changes are tried, and unchanged
tests are not run again to record the lines that they execute (`RESULTS.kept`). Prints the survivors
and a row for each package; exit code 1 if a change survives that `equivalent_mutants` does not
explain.
"""

import argparse
import hashlib
import json
import os
import queue
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from verification.mutation import parts
from verification.mutation.mutants import Place, change, places, statement_lines
from verification.mutation.server import Answer, Job, Recorded

ROOT = Path(__file__).resolve().parents[2]
COPIED = (
    "src",
    "tests",
    "verification",
    "studies",
    "tools",
    "docs",
    "examples",
    "pyproject.toml",
    "README.md",
)
UNCHANGED_S = 3600
"""The time limit for the tests of one file without a change."""
LONGER = 3
"""The factor by which a second try may take longer after a time-out."""


class Mutant(NamedTuple):
    module: str
    place: Place
    source: str


class Result(NamedTuple):
    """The result of a change: one line of the results file."""

    module: str
    line: int
    operator: str
    before: str
    after: str
    end: str
    """killed, survived, not run (no test executes the line), or timed out (twice)."""
    seconds: float

    @property
    def key(self) -> tuple[str, int, str, str]:
        return self.module, self.line, self.before, self.after


class Server:
    """A process of `verification.mutation.server` in a copy of the project."""

    def __init__(self, folder: Path, preloaded: Sequence[str]) -> None:
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(
                    source, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".*")
                )
            else:
                shutil.copy2(source, folder / name)
        variables = {
            "PYTHONPATH": str(folder / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "XLA_FLAGS": "--xla_backend_optimization_level=0",  # the tests compute little
        }
        self.folder = folder
        self._process = subprocess.Popen(
            [sys.executable, "-m", "verification.mutation.server", *preloaded],
            cwd=folder,
            env=os.environ | variables,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, job: Job) -> Answer:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(job._asdict()) + "\n")
        self._process.stdin.flush()
        return Answer(**json.loads(self._process.stdout.readline()))

    @contextmanager
    def changed(self, mutant: Mutant) -> Iterator[None]:
        path = self.folder / "src" / "skystack" / mutant.module
        before = path.read_text()
        path.write_text(mutant.source)
        try:
            yield
        finally:
            path.write_text(before)

    def close(self) -> None:
        self._process.communicate()


class File(NamedTuple):
    """A test file and its run without a change."""

    name: str
    recorded: Recorded
    wall_s: float
    cpu_s: float


class Run:
    """The changes of one package, tried by several servers at once."""

    def __init__(self, servers: Sequence[Server], kept: Path, slowest_s: float) -> None:
        self._servers: queue.Queue[Server] = queue.Queue()
        for server in servers:
            self._servers.put(server)
        self._workers, self._slowest_s = len(servers), slowest_s
        self._records, self._programs = kept / "notes", kept / "programs"
        for folder in (self._records, self._programs):
            folder.mkdir(parents=True, exist_ok=True)
        self._sources = _digest(
            *sorted(ROOT.glob("src/**/*.py")), *sorted(ROOT.rglob("conftest.py"))
        )
        self._files: dict[str, File] = {}

    def record(self, names: Iterable[str]) -> None:
        """Run test files without a change, and record the lines that they execute."""
        with ThreadPoolExecutor(self._workers) as pool:
            for file in pool.map(self._recorded, names):
                self._files[file.name] = file
                for test in file.recorded.failed:
                    say(f"left out: {test}: fails without a change")
                for test, seconds in file.recorded.seconds.items():
                    if seconds > self._slowest_s:
                        say(f"left out: {test}: takes {seconds:.0f} s of processor time")
                say(f"{file.name}: {len(file.recorded.seconds)} tests, {file.wall_s:.0f} s")

    def try_all(self, mutants: Iterable[Mutant]) -> Iterator[Result]:
        with ThreadPoolExecutor(self._workers) as pool:
            yield from pool.map(self._tried, mutants)

    def _recorded(self, name: str) -> File:
        path = self._records / f"{_digest(ROOT / name)}-{self._sources}.json"
        if not path.exists():
            file = self._run_unchanged(name)
            path.write_text(json.dumps([file.recorded, *file[2:]]))
        recorded, wall_s, cpu_s = json.loads(path.read_text())
        return File(name, Recorded(*recorded), wall_s, cpu_s)

    def _run_unchanged(self, name: str) -> File:
        server = self._servers.get()
        try:
            programs = Path(tempfile.mkdtemp(dir=server.folder))
            record = programs / "recorded.json"
            left_out, limit_s = list(parts.LEFT_OUT), UNCHANGED_S
            job = Job("", [name], left_out, {}, str(programs), str(record), limit_s, limit_s)
            answer = server.run(job)
            if not record.exists():
                sys.exit(f"verification.mutation.run: {name} {answer.end}: {_last(server)}")
            recorded = Recorded(**json.loads(record.read_text()))
            if recorded.failed:
                say(_last(server))
            record.unlink()
            for path in programs.iterdir():
                if not (self._programs / path.name).exists():
                    path.replace(self._programs / path.name)
        finally:
            self._servers.put(server)
        return File(name, recorded, answer.wall_s, answer.cpu_s)

    def _tried(self, mutant: Mutant) -> Result:
        server = self._servers.get()
        try:
            with server.changed(mutant):
                original = (ROOT / "src" / "skystack" / mutant.module).read_text()
                files = self._running(mutant, original)
                started = time.monotonic()
                end = self._end(server, mutant, files) if files else "not run"
                lines = change(original, mutant.source)
                return Result(
                    module=mutant.module,
                    line=lines.line,
                    operator=mutant.place.operator,
                    before=lines.before,
                    after=lines.after,
                    end=end,
                    seconds=round(time.monotonic() - started, 1),
                )
        finally:
            self._servers.put(server)

    def _running(self, mutant: Mutant, original: str) -> list[File]:
        """The test files that execute the changed statement, the fastest first."""
        lines = set(statement_lines(original, mutant.place.line))
        path = f"skystack/{mutant.module}"
        names = parts.tests(ROOT, mutant.module)
        return sorted(
            (
                file
                for file in map(self._files.__getitem__, names)
                if mutant.module in parts.IN_PROCESSES
                or lines & set(file.recorded.lines.get(path, ()))
            ),
            key=lambda file: file.wall_s,
        )

    def _end(self, server: Server, mutant: Mutant, files: list[File]) -> str:
        seconds: dict[str, float] = {}
        left_out = list(parts.LEFT_OUT)
        for file in files:
            seconds |= file.recorded.seconds
            slow = [test for test, took in file.recorded.seconds.items() if took > self._slowest_s]
            left_out += file.recorded.failed + slow
        module = "skystack." + mutant.module.removesuffix(".py").replace("/", ".")
        for times in (1, LONGER):
            cpu_s = int(times * (30.0 + 3.0 * sum(file.cpu_s for file in files)))
            wall_s = times * (120.0 + 10.0 * sum(file.wall_s for file in files))
            names = [file.name for file in files]
            answer = server.run(
                Job(module, names, left_out, seconds, str(self._programs), None, cpu_s, wall_s)
            )
            if answer.end == "no tests":
                reason = _last(server)
                sys.exit(f"verification.mutation.run: {mutant.module}: no tests were run: {reason}")
            if answer.end != "timed out":
                return "survived" if answer.end == "passed" else "killed"
        return "timed out"


def _last(server: Server) -> str:
    log = (server.folder / "log.txt").read_text().strip()
    return log[-2000:] or "nothing was printed"


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def chosen(modules: Sequence[str], sample: int | None, seed: int) -> list[Mutant]:
    """All changes of the modules, or a random sample, spread over them in proportion."""
    generator = random.Random(seed)
    every: list[tuple[str, str, Place]] = []
    for module in modules:
        source = (ROOT / "src" / "skystack" / module).read_text()
        found = places(source)
        generator.shuffle(found)
        every += [(module, source, place) for place in found]
    if sample is not None and sample < len(every):
        offset = generator.random()
        every = [every[int((number + offset) * len(every) / sample)] for number in range(sample)]
        generator.shuffle(every)  # so that a part of the sample is a sample too
    mutants = (Mutant(module, place, place.changed()) for module, _, place in every)
    return [new for new, (_, source, _) in zip(mutants, every, strict=True) if new.source != source]


def read_results(path: Path | None) -> dict[tuple[str, int, str, str], Result]:
    if path is None or not path.exists():
        return {}
    results = (Result(**json.loads(line)) for line in path.read_text().splitlines())
    return {result.key: result for result in results}


def run_package(package: str, modules: Sequence[str], options: argparse.Namespace) -> Counter[str]:
    """Try the changes of a package that have no result yet, and print the survivors."""
    known = read_results(options.results)
    if options.retry:
        known = {key: result for key, result in known.items() if result.end == "killed"}
    mutants, results, missing = chosen(modules, options.sample, options.seed), [], []
    for mutant in mutants:
        original = (ROOT / "src" / "skystack" / mutant.module).read_text()
        result = known.get((mutant.module, *change(original, mutant.source)))
        results += [result] if result else []
        missing += [] if result else [mutant]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if missing:
            kept = options.results.with_suffix(".kept") if options.results else folder
            run = Run(_servers(stack, folder, package, options), kept, options.slowest)
            names = {name: None for new in missing for name in parts.tests(ROOT, new.module)}
            run.record(names)
            for number, result in enumerate(run.try_all(missing), start=1):
                results.append(result)
                if options.results:
                    with options.results.open("a") as file:
                        file.write(json.dumps(result._asdict()) + "\n")
                say(
                    f"{number}/{len(missing)} {result.end}, {result.seconds:.0f} s: {_text(result)}"
                )
    return _counted(package, results)


def _servers(
    stack: ExitStack, folder: Path, package: str, options: argparse.Namespace
) -> list[Server]:
    servers = []
    for number in range(options.workers):
        server = Server(folder / str(number), parts.PRELOADED[package])
        stack.callback(server.close)
        servers.append(server)
    return servers


def _digest(*paths: Path) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(f"{path}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _text(result: Result) -> str:
    return f"{result.module}:{result.line}: {result.before} -> {result.after}"


def _counted(package: str, results: Sequence[Result]) -> Counter[str]:
    reasons, counts = parts.equivalent(package), Counter[str]()
    for result in results:
        end = result.end
        if end != "killed" and (result.module, result.before, result.after) in reasons:
            end = "equivalent"
        counts[end] += 1
        if end in ("survived", "not run"):
            say(f"{end}: {_text(result)}")
    return counts


def row(package: str, counts: Counter[str], seconds: float) -> str:
    """The summary line of a package."""
    effective = counts.total() - counts["equivalent"]
    ends = ("killed", "survived", "not run", "timed out", "equivalent")
    numbers = ", ".join(f"{counts[end]} {end}" for end in ends)
    share = 100.0 * counts["killed"] / max(effective, 1)
    return f"{package}: {counts.total()} changes: {numbers}; {share:.0f} % killed; {seconds:.0f} s"


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--package", choices=parts.PRELOADED, help="only this package")
    parser.add_argument("--only", metavar="MODULE", help="only this module, such as tasks/pairs.py")
    parser.add_argument("--sample", type=int, metavar="N", help="try N changes of each package")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--workers", type=int, default=1, help="number of parallel processes")
    slowest = "leave out tests that take more processor time than this without a change"
    parser.add_argument("--slowest", type=float, default=30.0, metavar="S", help=slowest)
    parser.add_argument("--results", type=Path, help="file to which results are appended")
    parser.add_argument("--retry", action="store_true", help="try changes again that survived")
    options = parser.parse_args(arguments)
    survived = 0
    for package, modules in _selected(parser, options).items():
        started = time.monotonic()
        counts = run_package(package, modules, options)
        say(row(package, counts, time.monotonic() - started))
        survived += counts["survived"] + counts["not run"] + counts["timed out"]
    return 1 if survived else 0


def _selected(
    parser: argparse.ArgumentParser, options: argparse.Namespace
) -> dict[str, tuple[str, ...]]:
    every = {package: parts.modules(ROOT, package) for package in parts.PRELOADED}
    if options.only:
        every = {
            package: (options.only,) for package, names in every.items() if options.only in names
        }
        if not every:
            parser.error(f"{options.only} is not one of the modules that are changed")
    return {
        package: names for package, names in every.items() if options.package in (None, package)
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
