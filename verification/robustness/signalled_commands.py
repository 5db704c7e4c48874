"""Send SIGINT or SIGTERM to commands at random moments: each must end promptly and cleanly.

    python -m verification.robustness.signalled_commands [--signals N] [--seed S] [--only WHAT ...]

Each signal comes at a random moment of a run, including its start and end. Half of the SIGINTs are
sent to the whole process group, as a terminal does. A process is stopped before its signal and
continued afterwards, so that it is certainly alive at that moment. Afterwards:

- the exit code is 130 (SIGINT) or 143 (SIGTERM), or the process was killed by the signal itself,
  which a shell reports as the same number: before Python runs skystack's first line, or after its
  last one (if `python -m` is interrupted while it starts, Python exits with 1; counted with these);
- standard error has no traceback, unless Python is interrupted before skystack's first line;
- no file is half-written, and nothing is left next to the output, in the folder for temporary files
  or in the cache of programs (folders of killed workers must be deleted by a command a minute
  later, which is checked once, at the end);
- no process is left.

A training is resumed after each signal and must give the result of an undisturbed one. Prints the
counts for each verb; exit code 1 if anything is wrong.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pyarrow.parquet as pq
from safetensors.numpy import load

from skystack.compilation.programs import IDLE_S, RUNNING
from verification.robustness.killed_trainings import SUBJECTS, finish, outcome, train_command

EXAMPLES = Path(__file__).parents[2] / "examples"
SKYSTACK = (sys.executable, "-m", "skystack")
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}
LIMIT_S = 1800.0
ORPHAN_S = 10.0
"""The time that the processes of a command have to end after it."""
QUICK = {
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    "XLA_FLAGS": "--xla_cpu_use_fusion_emitters=false",
}
"""Compilation takes a third of the time with these; the programs need not be fast."""
MARK = "SKYSTACK_SIGNALLED"
"""A variable in the environment of a command, inherited by all its children."""

REPRODUCTION = """
import sys
from skystack.__main__ import run
from skystack.reproduction import plan

if __name__ == "__main__":
    plan.QUICK_STEPS = 8192
    plan.families_of_experiments = lambda: {"lateral": ["lateral"]}
    sys.argv[0] = "skystack"
    run()
"""


class Place(NamedTuple):
    """The folders that a command uses."""

    folder: Path
    """Its own working folder."""
    evaluation: Path
    """An evaluation to read."""
    training: Path
    """A training to read."""


class Subject(NamedTuple):
    """A command that is signalled."""

    command: Callable[[Place], Sequence[str]]
    weight: int = 1
    """Its share of the signals."""
    compiles: bool = False
    """Whether it is faster once its programs are cached."""
    has_workers: bool = False
    """Whether it kills its own workers, which then leave folders in the cache."""


def _train(place: Place) -> list[str]:
    return train_command(place.folder / "run")


def _evaluate(place: Place, *options: str) -> list[str]:
    out = str(place.folder / "evaluations")
    return [*SKYSTACK, "evaluate", "lateral", "--episodes", "20", "--out", out, *options]


def _evaluate_on_bluebird(place: Place) -> list[str]:
    return _evaluate(place, "--platform", "bluebird", "--episodes", "2")


def _reproduce(place: Place) -> list[str]:
    words = ["reproduce", "--quick", "--episodes", "3", "--out", str(place.folder / "run")]
    return [sys.executable, "-c", REPRODUCTION, *words]


def _simulate(place: Place) -> list[str]:
    output = str(place.folder / "flown.parquet")
    return [*SKYSTACK, "simulate", str(EXAMPLES / "reference.json"), "-o", output]


def _replay(place: Place, suffix: str) -> list[str]:
    output = str(place.folder / f"replay{suffix}")
    return [*SKYSTACK, "replay", str(place.evaluation), "-o", output]


def _report(place: Place) -> list[str]:
    return [*SKYSTACK, "report", str(place.training), "-o", str(place.folder / "page.html")]


def _sector(place: Place) -> list[str]:
    return [*SKYSTACK, "sector", "x-plus", "-o", str(place.folder / "map.png")]


def _export(place: Place) -> list[str]:
    output = str(place.folder / "policy.npz")
    return [*SKYSTACK, "export", "lateral", "--format", "numpy", "-o", output]


SIGNALLED = {
    "simulate": Subject(_simulate, 3),
    "evaluate": Subject(_evaluate, 4, compiles=True),
    "evaluate --platform": Subject(_evaluate_on_bluebird, 2, compiles=True, has_workers=True),
    "train": Subject(_train, 4),
    "reproduce": Subject(_reproduce, 3, compiles=True, has_workers=True),
    "replay, a page": Subject(lambda place: _replay(place, ".html"), 2),
    "replay, a film": Subject(lambda place: _replay(place, ".gif"), 2),
    "report": Subject(_report, 2),
    "sector": Subject(_sector),
    "export": Subject(_export),
}


_READ_EVALUATION = {"replay, a page", "replay, a film"}
_READ_TRAINING = {"train", "report"}


class Ended(NamedTuple):
    """How a signalled command ended."""

    how: str
    """`code`: with the exit code; `signal`: killed by the signal; `before`: before the signal."""
    wrong: tuple[str, ...]
    """Descriptions of everything that is wrong."""


def signalled(
    command: Sequence[str],
    place: Place,
    number: signal.Signals,
    to_group: bool,
    due: Callable[[], bool],
    has_workers: bool = False,
) -> Ended:
    """Start a command, signal it when that is due, and check what is left."""
    scratch = place.folder.parent / "scratch"
    scratch.mkdir(exist_ok=True)
    running = _running()
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    with (scratch.parent / "stderr").open("w+b") as err:
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=err,
            start_new_session=True,
            env=os.environ | {"TMPDIR": str(scratch), MARK: mark},
            # Background processes of a script ignore SIGINT, and their children inherit that.
            preexec_fn=_reset_sigint,  # noqa: PLW1509  (this process has no threads)
        )
        while process.poll() is None and not due():
            time.sleep(0.001)
        sent = _signal(process, number, to_group)
        try:
            code = process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return Ended("code", (f"continued for {LIMIT_S:.0f} s",))
        err.seek(0)
        stderr = err.read().decode(errors="replace")
    left = (*_left_behind(place.folder, scratch), *_orphans(mark))
    if not has_workers:
        left += tuple(f"left behind: {path}" for path in _running() - running)
    if not sent:
        return Ended("before", (*_failed(code, stderr), *left))
    how, wrong = _check_exit(code, number, stderr)
    return Ended(how, (*wrong, *left))


def _reset_sigint() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _signal(process: subprocess.Popen[bytes], number: signal.Signals, to_group: bool) -> bool:
    """Stop a process, send it the signal and continue it; False if it had ended before."""
    if process.poll() is not None:
        return False
    os.kill(process.pid, signal.SIGSTOP)
    state = os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    if state is None or state.si_code not in (os.CLD_STOPPED, os.CLD_TRAPPED):
        return False
    os.waitid(os.P_PID, process.pid, os.WSTOPPED)
    send = os.killpg if to_group else os.kill
    send(process.pid, number)
    os.kill(process.pid, signal.SIGCONT)
    return True


def _failed(code: int, stderr: str) -> Iterator[str]:
    if code != 0:
        yield f"exited with {code} without a signal: {stderr[-2000:]}"


def _check_exit(code: int, number: signal.Signals, stderr: str) -> tuple[str, tuple[str, ...]]:
    if code == -number or stderr.startswith("Could not import runpy module"):
        return "signal", ()  # any traceback is from Python, before skystack's first line
    wrong = []
    if code != CODES[number]:
        wrong.append(f"exit code {code} after {number.name}: {stderr[-2000:]}")
    if "Traceback" in stderr or "Error" in stderr or "xception" in stderr:
        wrong.append(f"a traceback after {number.name} ({code}): {stderr[-3000:]}")
    return "code", tuple(wrong)


def _left_behind(folder: Path, scratch: Path) -> Iterator[str]:
    """Files that must not exist after a command has ended."""
    for path in (*folder.rglob("*.aside"), *scratch.iterdir()):
        yield f"left behind: {path}"
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not _whole(path):
            yield f"half-written: {path}"


def _running() -> set[Path]:
    """The cache folders of processes that are running or were killed."""
    return set(Path(os.environ["SKYSTACK_CACHE"]).rglob(f"{RUNNING}*"))


def _whole(path: Path) -> bool:
    """Whether a file is complete."""
    data = path.read_bytes()
    try:
        if path.suffix == ".parquet":
            pq.read_table(path)
        elif path.suffix == ".safetensors":
            load(data)
        elif path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".jsonl":
            [json.loads(line) for line in data.splitlines()]
    except Exception:  # each reader has its own errors
        return False
    ends = {
        ".html": b"</html>",
        ".svg": b"</svg>",
        ".gif": b"\x3b",
        ".png": b"IEND\xae\x42\x60\x82",
    }
    return data.rstrip().endswith(ends.get(path.suffix, b""))


def _orphans(mark: str) -> Iterator[str]:
    """Processes of the command that are still running after `ORPHAN_S`; they are killed."""
    deadline = time.monotonic() + ORPHAN_S
    while (running := _marked(mark)) and time.monotonic() < deadline:
        time.sleep(0.1)
    for number, command in running.items():
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
        yield f"still running: {command}"


def _marked(mark: str) -> dict[int, str]:
    found = {}
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and f"{MARK}={mark}".encode() in (
                entry / "environ"
            ).read_bytes().split(b"\0"):
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ")
                found[int(entry.name)] = command.decode(errors="replace")[-200:]
    return found


def at(moment: float) -> Callable[[], bool]:
    """Due at a time of the monotonic clock."""
    return lambda: time.monotonic() >= moment


class Study:
    """Sends all signals and counts the results."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._random = folder, random.Random(seed)
        evaluation = folder / "known" / "evaluations" / "lateral-s0-skystack-stacked"
        self._known = Place(folder / "known", evaluation, folder / "known" / "run")
        self.counts: dict[str, Counter[str]] = {}
        self.wrong: list[str] = []
        self._took: dict[str, float] = {}

    def prepare(self, names: Sequence[str]) -> None:
        """Make what the commands read, and run each one until its programs are cached."""
        self._known.folder.mkdir()
        reads = {"evaluate": _READ_EVALUATION, "train": _READ_TRAINING}
        for name, readers in reads.items():
            if readers & set(names):
                finish(SIGNALLED[name].command(self._known), LIMIT_S)
        for name in names:
            for number in range(1 + SIGNALLED[name].compiles):
                place = self._known._replace(folder=self._folder / f"{name}-{number}")
                place.folder.mkdir()
                self._took[name] = finish(SIGNALLED[name].command(place), LIMIT_S)
            sys.stderr.write(f"{name}: {self._took[name]:.1f} s without a signal\n")

    def signal_all(self, names: Sequence[str], count: int) -> None:
        """Send `count` signals, shared among the commands by their weights."""
        weights = [SIGNALLED[name].weight for name in names]
        for number in range(count):
            name = self._random.choices(names, weights)[0]
            while not self._once(name, number):
                pass
            if number % 10 == 9:
                sys.stderr.write(f"{number + 1} signals, {len(self.wrong)} wrong\n")
        if "train" in names:
            self._finish_training()
        if any(SIGNALLED[name].has_workers for name in names):
            self._clean_cache()

    def _once(self, name: str, number: int) -> bool:
        """Signal one command; False if it had ended before."""
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            work = Path(folder) / "work"
            work.mkdir()
            place = self._known._replace(folder=work)
            if name == "train":
                place = self._known._replace(folder=self._folder / "resumed")
                place.folder.mkdir(exist_ok=True)
            which = self._random.choice(list(CODES))
            to_group = which == signal.SIGINT and self._random.random() < 0.5
            started = time.monotonic()
            moment = started + self._random.uniform(0.0, self._took[name])
            subject = SIGNALLED[name]
            command = subject.command(place)
            ended = signalled(command, place, which, to_group, at(moment), subject.has_workers)
        self.counts.setdefault(name, Counter())[ended.how] += 1
        if ended.wrong:
            self.counts[name]["wrong"] += 1
            sent = f"{which.name} to {'the group' if to_group else 'the process'}"
            self.wrong.append("\n".join((f"signal {number}, {name}, {sent}:", *ended.wrong)))
            sys.stderr.write(self.wrong[-1] + "\n")
        if ended.how == "before":  # the machine has become less busy
            self._took[name] = min(self._took[name], time.monotonic() - started)
            if name == "train":
                self._finish_training()
        return ended.how != "before"

    def _clean_cache(self) -> None:
        """Check that a later command deletes the folders of killed workers in the cache."""
        for path in _running():
            os.utime(path, (time.time() - 2 * IDLE_S,) * 2)
        place = self._known._replace(folder=self._folder / "later")
        place.folder.mkdir()
        finish(SIGNALLED["evaluate"].command(place), LIMIT_S)
        self.wrong += (f"never deleted: {path}" for path in _running())

    def _finish_training(self) -> None:
        place = self._known._replace(folder=self._folder / "resumed")
        place.folder.mkdir(exist_ok=True)
        finish(_train(place), LIMIT_S)
        known, resumed = (
            outcome(SUBJECTS["training"], folder)
            for folder in (self._known.training, place.folder / "run")
        )
        if resumed != known:
            self.wrong.append("a resumed training gave another result")
        place.folder.rename(self._folder / f"finished-{time.monotonic_ns()}")


def main() -> int:
    """Returns the exit code: 0 nothing is wrong, 1 something is wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--signals", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=list(SIGNALLED), default=list(SIGNALLED))
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    names = [name for name in options.only if name != "evaluate --platform" or _bluebird()]
    with tempfile.TemporaryDirectory(prefix="signalled-") as folder:
        os.environ |= QUICK | {"SKYSTACK_CACHE": f"{folder}/programs"}
        study = Study(Path(folder), options.seed)
        try:
            study.prepare(names)
            study.signal_all(names, options.signals)
        except KeyboardInterrupt:
            sys.stdout.write("interrupted; so far:\n")
    for name, counts in study.counts.items():
        sent = counts["code"] + counts["signal"]
        sys.stdout.write(
            f"{name}: {sent} signals, {counts['code']} ended with the exit code, "
            f"{counts['signal']} killed by the signal itself, {counts['wrong']} wrong\n"
        )
    for wrong in study.wrong:
        sys.stdout.write(f"{wrong}\n")
    return 1 if study.wrong else 0


def _bluebird() -> bool:
    return find_spec("bluebird_dt") is not None and find_spec("pebble") is not None


if __name__ == "__main__":
    sys.exit(main())
