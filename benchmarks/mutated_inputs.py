"""Files made wrong in many ways: each must be read, or be refused in one clear line.

    python -m benchmarks.mutated_inputs [--format NAME|all] [--count N] [--seed S]
        [--seconds LIMIT] [--keep DIR]

Input i of a format depends only on the seed and i. Anything but a result without a NaN or one line
of refusal is a finding: another exception, a warning, more than 10 s, more than 1 GB of memory, the
end of the process. Findings are printed and their files kept under DIR. Prints a table and exits 1
where there are any.
"""

import argparse
import multiprocessing
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.untrusted_files import FORMATS, Files, Format
from skystack.errors import InputError

LONGEST_S = 10.0
MOST_BYTES = 1_000_000_000
LONGEST_LINE = 4000
DEAD_S = 60.0
"""A process that has not come further for so long is ended."""


@dataclass
class Tally:
    """What came of inputs so far."""

    read: int = 0
    refused: int = 0
    findings: dict[int, str] = field(default_factory=dict)
    """What was found, by the number of the input."""
    wall_s: float = 0.0

    @property
    def inputs(self) -> int:
        return self.read + self.refused + len(self.findings)


class Trial:
    """Gives the inputs of one format to its reader, in a folder of their own."""

    def __init__(self, kind: Format, seed: int, folder: Path) -> None:
        self._kind, self._seed, self._folder = kind, seed, folder
        self._there: dict[str, bytes] = {}

    def files(self, number: int) -> dict[str, bytes]:
        """The input of a number."""
        return self._kind.mutated(Random(f"{self._seed} {self._kind.name} {number}"))

    def valid(self) -> None:
        """Read what is not mutated; it also compiles all that is to be compiled."""
        for seed in self._kind.seeds:
            self._lay_out(seed)
            self._kind.read(self._folder)

    def tried(self, number: int, tally: Tally) -> None:
        """Read one input and count what came of it."""
        self._lay_out(self.files(number))
        begun, peak = time.monotonic(), _peak_bytes()
        finding, refused = None, False
        try:
            self._kind.read(self._folder)
        except InputError as error:
            refused = True
            finding = _unclear(str(error))
        except Exception as error:  # whatever it is, it should have been an InputError
            finding = f"{type(error).__name__}: {str(error)[:200]!r} at {_place(error)}"
        took_s = time.monotonic() - begun
        if took_s > LONGEST_S:
            finding = f"took {took_s:.0f} s"
        if _peak_bytes() - peak > MOST_BYTES:
            finding = f"took {(_peak_bytes() - peak) / 1e9:.1f} GB"
        if finding is not None:
            tally.findings[number] = finding
        elif refused:
            tally.refused += 1
        else:
            tally.read += 1

    def _lay_out(self, files: Files) -> None:
        for name in self._there.keys() - files.keys():
            (self._folder / name).unlink()
        for name, data in files.items():
            if self._there.get(name) != data:
                (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
                (self._folder / name).write_bytes(data)
        self._there = dict(files)


def _unclear(line: str) -> str | None:
    """Why a refusal is not one clear line; None where it is."""
    if not line.isprintable() or not line:
        return f"the refusal is not one printable line: {line[:200]!r}"
    if len(line) > LONGEST_LINE:
        return f"the refusal has {len(line)} characters: {line[:200]!r}"
    return None


def _place(error: BaseException) -> str:
    """The innermost line of ours that an exception came through."""
    place, trace = "", error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if "skystack" in code.co_filename or not place:
            place = f"{Path(code.co_filename).name}:{trace.tb_lineno} {code.co_name}"
        trace = trace.tb_next
    return place


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def try_inputs(
    kind: Format,
    numbers: range,
    seed: int,
    seconds: float,
    on_input: Callable[[int, Tally], None] = lambda number, tally: None,
) -> Tally:
    """Try inputs in this process until they or the seconds are used up.

    `on_input` hears the number of each before it is tried.
    """
    tally, begun = Tally(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutated-") as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        trial = Trial(kind, seed, Path(folder))
        trial.valid()
        begun = time.monotonic()
        for number in numbers:
            on_input(number, tally)
            trial.tried(number, tally)
            tally.wall_s = time.monotonic() - begun
            if tally.wall_s > seconds:
                break
    return tally


def _work(name: str, numbers: range, seed: int, seconds: float, parent: Connection) -> None:
    """In a process of its own: says what it tries next, at most every tenth of a second or so."""
    kind, limited = FORMATS[name](), False

    def report(number: int, tally: Tally) -> None:
        nonlocal limited
        if not limited:  # not before all is compiled
            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + 2 * MOST_BYTES,) * 2)
            limited = True
        parent.send((number, tally))

    parent.send((None, try_inputs(kind, numbers, seed, seconds, report)))


def try_apart(
    name: str, count: int, seed: int, seconds: float, on_input: Callable[[int], None]
) -> Tally:
    """Try inputs in a process of its own; one that ends or hangs is a finding, and goes on anew."""
    total, first, spawn = Tally(), 0, multiprocessing.get_context("spawn")
    while first < count and total.wall_s < seconds:
        ours, theirs = spawn.Pipe(duplex=False)
        rest = range(first, count), seed, seconds - total.wall_s
        process = spawn.Process(target=_work, args=(name, *rest, theirs))
        process.start()
        theirs.close()
        number, tally = first, Tally()
        try:
            while ours.poll(DEAD_S if number is not None else None):
                number, tally = ours.recv()
                if number is None:
                    break
                on_input(number)
        except EOFError:
            pass
        ended = number is None
        if not ended:
            process.kill()
        process.join()
        total.read += tally.read
        total.refused += tally.refused
        total.findings |= tally.findings
        total.wall_s += tally.wall_s
        if ended:
            break
        total.findings[number] = f"the process hung or ended ({process.exitcode})"
        first = number + 1
    return total


def keep(name: str, seed: int, number: int, where: Path) -> Path:
    """Write the files of an input into a folder of its own under `where`."""
    folder = where / f"{name}-{seed}-{number}"
    for file, data in Trial(FORMATS[name](), seed, folder).files(number).items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(data)
    return folder


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--format", choices=[*FORMATS, "all"], default="all")
    parser.add_argument("--count", type=int, default=1000, help="inputs a format (default 1,000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9, help="the most a format may take")
    parser.add_argument("--keep", type=Path, help="folder for the files of findings")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 nothing found, 1 findings."""
    options, console = _options(arguments), Console(stderr=True)
    names = list(FORMATS) if options.format == "all" else [options.format]
    table = Table("format", "inputs", "read", "refused", "findings", "inputs per second")
    found = 0
    for name in names:
        with Progress(console=console) as bars:
            bar = bars.add_task(name, total=options.count)
            tally = try_apart(
                name,
                options.count,
                options.seed,
                options.seconds,
                lambda done, bar=bar, bars=bars: bars.update(bar, completed=done),  # type: ignore[misc]
            )
        counts = (tally.inputs, tally.read, tally.refused, len(tally.findings))
        rate = tally.inputs / max(tally.wall_s, 1e-9)
        table.add_row(name, *(f"{count:,}" for count in counts), f"{rate:,.0f}")
        found += len(tally.findings)
        for number, what in tally.findings.items():
            console.print(f"{name} {number}: {what}", markup=False, highlight=False)
            if options.keep is not None:
                keep(name, options.seed, number, options.keep)
    Console(width=100).print(table)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
