"""Give inputs to the reader of their format, one after the other, and count the results."""

import os
import resource
import sys
import time
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import NoReturn

from skystack.errors import InputError
from verification.inputs.audit import watched
from verification.inputs.shares import Share, Tally, keep_files
from verification.inputs.untrusted_files import FORMATS, Files, Format

Report = Callable[[int | None, Tally], None]

LONGEST_S = 10.0
"""The limit of processor time per input; on a shared machine the wall time may be longer."""
SLOWER = 5.0
"""The factor by which instrumentation slows Python down, at least."""
MOST_BYTES = 1_000_000_000
LONGEST_LINE = 4000
CORPUS = 200
"""The number of random inputs that a guided trial starts with."""
CHOICES = 256
"""The maximum number of bytes that encode the choices of an input; most need fewer than 100."""


def source(share: Share, number: int) -> Random:
    """The generator of an input, seeded with the seed, the format and the input's number."""
    return Random(f"{share.seed} {share.format} {number}")


class Choices(Random):
    """A generator that reads its choices from given bytes, so that a fuzzer can change each choice.

    When these are used up, it continues with pseudo-random numbers of a fixed seed.
    """

    def __init__(self, given: bytes) -> None:
        super().__init__(0)
        self._given, self._at = given, 0

    def getrandbits(self, k: int, /) -> int:
        size = -(-k // 8)
        taken = self._given[self._at : self._at + size]
        if len(taken) < size:
            return super().getrandbits(k)
        self._at += size
        return int.from_bytes(taken, "little") >> (8 * size - k)

    def random(self) -> float:
        return self.getrandbits(53) * 2.0**-53


class Trial:
    """Tries the inputs of a share, one by one, in a folder."""

    def __init__(self, kind: Format, share: Share, folder: Path) -> None:
        """First read the unmutated files, which also compiles all programs."""
        self._kind, self._share, self._folder = kind, share, folder
        self._present: dict[str, bytes] = {}
        for seed in kind.seeds:
            self._write_files(seed)
            kind.read(folder)
        self.number, self.tally = share.first, Tally()
        self._started = time.monotonic()

    def over(self) -> bool:
        """Whether the inputs or the seconds are used up."""
        self.tally.wall_s = time.monotonic() - self._started
        return self.number >= self._share.end or self.tally.wall_s > self._share.seconds

    def next(self, random: Random) -> None:
        """Make the next input with these choices, read it and count the result."""
        self._write_files(self._kind.mutated(random))
        before, started, peak = self._names(), time.process_time(), _peak_bytes()
        finding, refused = None, False
        try:
            with watched(self._folder) as watch:
                self._kind.read(self._folder)
        except InputError as error:
            refused = True
            finding = _unclear(str(error))
        except Exception as error:  # only an InputError is allowed
            finding = f"{type(error).__name__}: {str(error)[:200]!r} at {_place(error)}"
        if watch.found:
            finding = f"forbidden access: {watch.found[0]}"
        elif written := self._names() - before:
            finding = f"wrote {sorted(written)}"
        took_s = time.process_time() - started
        if took_s > LONGEST_S * (SLOWER if self._share.guided else 1.0):
            finding = f"took {took_s:.0f} s"
        if _peak_bytes() - peak > MOST_BYTES:
            finding = f"took {(_peak_bytes() - peak) / 1e9:.1f} GB"
        if finding is not None:
            self.tally.findings[self.number] = finding
            keep_files(self._share, self.number, self._folder)
        elif refused:
            self.tally.refused += 1
        else:
            self.tally.read += 1
        self.number += 1

    def _names(self) -> set[str]:
        """The names of everything in the folder, and of its siblings."""
        within = (
            str(Path(place, name).relative_to(self._folder))
            for place, folders, names in os.walk(self._folder)
            for name in (*folders, *names)
        )
        return {*within, *(f"../{path.name}" for path in self._folder.parent.iterdir())}

    def _write_files(self, files: Files) -> None:
        for name in self._present.keys() - files.keys():
            (self._folder / name).unlink()
        for name, data in files.items():
            if self._present.get(name) != data:
                (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
                (self._folder / name).write_bytes(data)
        self._present = dict(files)


def _unclear(line: str) -> str | None:
    """Why a refusal is not one clear line; None if it is."""
    if not line.isprintable() or not line:
        return f"the refusal is not one printable line: {line[:200]!r}"
    if len(line) > LONGEST_LINE:
        return f"the refusal has {len(line)} characters: {line[:200]!r}"
    return None


def _place(error: BaseException) -> str:
    """The innermost line of skystack in the traceback of an exception."""
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
    kind: Format, share: Share, folder: Path, report: Report = lambda at, tally: None
) -> Tally:
    """Try a share of inputs in this process; `report` is called before each, with its number."""
    trial = Trial(kind, share, folder)
    while not trial.over():
        report(trial.number, trial.tally)
        trial.next(source(share, trial.number))
    return trial.tally


def try_guided(kind: Format, share: Share, folder: Path, report: Report) -> NoReturn:
    """Try inputs chosen by Atheris (libFuzzer), guided by the lines that earlier inputs reached.

    The fuzzer does not return: after the last input `report(None)` is called, and the process
    exits.
    """
    import atheris  # noqa: PLC0415  (an extra)

    trial = Trial(kind, share, folder)

    def try_one(choices: bytes) -> None:
        report(trial.number, trial.tally)
        trial.next(Choices(choices))
        if trial.over():
            report(None, trial.tally)
            os._exit(0)

    first, corpus = Random(f"{share.seed} {share.first}"), folder.with_name("corpus")
    corpus.mkdir()
    for number in range(CORPUS):
        (corpus / str(number)).write_bytes(first.randbytes(CHOICES // 4))
    options = {"seed": first.randrange(1, 2**31), "max_len": CHOICES, "len_control": 0}
    # Time and memory are checked in Trial; without a timeout the fuzzer would end after a second.
    options |= {"timeout": 1000, "rss_limit_mb": 0, "verbosity": 0}
    arguments = [f"-{name}={value}" for name, value in options.items()]
    atheris.Setup([sys.argv[0], *arguments, str(corpus)], try_one)
    atheris.Fuzz()
    raise AssertionError("the fuzzer returned")


def work(share: Share, folder: Path, parent: Connection) -> None:
    """The main function of the process: sends the number of each input first, None at the end."""
    warnings.simplefilter("error")
    limited = False

    def report(number: int | None, tally: Tally) -> None:
        nonlocal limited
        if not limited:  # only after all programs are compiled
            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + 2 * MOST_BYTES,) * 2)
            limited = True
        parent.send((number, tally))

    kind = FORMATS[share.format]()
    if share.guided:
        try_guided(kind, share, folder, report)
    report(None, try_inputs(kind, share, folder, report))
