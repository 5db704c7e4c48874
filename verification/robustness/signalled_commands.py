"""Send SIGINT or SIGTERM to commands at random moments: each must end promptly and cleanly.

    python -m verification.robustness.signalled_commands [--signals N] [--seed S] [--only WHAT ...]

Each signal comes at a random moment of a run, starting and ending included, half of the SIGINTs to
the whole process group, as a terminal sends them. A process is stopped before and goes on after,
so that it surely lived when the signal came. Then:

- the exit code is 130 (SIGINT) or 143 (SIGTERM), or the process died of the signal itself, which a
  shell reports as the same number: before Python runs our first line, and after our last (where
  `python -m` itself is interrupted while it starts, Python ends with 1; counted with these);
- standard error has no traceback, but where Python itself is interrupted before our first line;
- no file is half-written, nothing is left beside the output, in the folder for temporary files or
  in the cache of programs (folders of killed workers must be deleted by a command a minute later;
  checked once, at the end);
- no process is left.

A training is resumed after each signal and must come to the end of one that nobody disturbed.
Prints the counts of each verb; exit code 1 when anything was wrong.
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
"""For processes of a command that has ended to notice it."""
QUICK = {
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    "XLA_FLAGS": "--xla_cpu_use_fusion_emitters=false",
}
"""Programs need not be fast here: made like this they take a third of the time."""
MARK = "SKYSTACK_SIGNALLED"
"""In the environment of a command and of all its children."""

REPRODUCTION = """
import sys
from skystack.__main__ import run
from skystack.reproduction import plan

if __name__ == "__main__":
    plan.QUICK_STEPS = 8192
    plan.FAMILIES["lateral"] = ("lateral",)
    sys.argv[0] = "skystack"
    run()
"""


class Place(NamedTuple):
    """Where a command works, and what it reads."""

    folder: Path
    """Of its own."""
    evaluation: Path
    training: Path


class Subject(NamedTuple):
    """A command that is signalled."""

    command: Callable[[Place], Sequence[str]]
    weight: int = 1
    """Its share of the signals."""
    compiles: bool = False
    """Whether it takes less time once its programs are kept."""
    has_workers: bool = False
    """Whether it kills its own workers, which then leave folders in the cache."""


def _train(place: Place) -> list[str]:
    return train_command(place.folder / "run")


def _evaluate(place: Place, *words: str) -> list[str]:
    out = str(place.folder / "evaluations")
    return [*SKYSTACK, "evaluate", "lateral", "--episodes", "20", "--out", out, *words]


def _elsewhere(place: Place) -> list[str]:
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
    "evaluate --platform": Subject(_elsewhere, 2, compiles=True, has_workers=True),
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
    """`code`: with the exit code; `signal`: by the signal itself; `before`: before it came."""
    wrong: tuple[str, ...]


def signalled(
    command: Sequence[str],
    place: Place,
    number: signal.Signals,
    to_group: bool,
    due: Callable[[], bool],
    has_workers: bool = False,
) -> Ended:
    """Start a command, signal it as soon as it is due and look at what is left."""
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
            # A background process of a script ignores SIGINT, and its children would inherit that.
            preexec_fn=_as_at_a_terminal,  # noqa: PLW1509  (this has no threads)
        )
        while process.poll() is None and not due():
            time.sleep(0.001)
        came = _signal(process, number, to_group)
        try:
            code = process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return Ended("code", (f"went on for {LIMIT_S:.0f} s",))
        err.seek(0)
        said = err.read().decode(errors="replace")
    left = (*_left_behind(place.folder, scratch), *_orphans(mark))
    if not has_workers:
        left += tuple(f"left behind: {path}" for path in _running() - running)
    if not came:
        return Ended("before", (*_failed(code, said), *left))
    how, wrong = _judge_exit(code, number, said)
    return Ended(how, (*wrong, *left))


def _as_at_a_terminal() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _signal(process: subprocess.Popen[bytes], number: signal.Signals, to_group: bool) -> bool:
    """Send the signal to a process that is stopped meanwhile; False if it had ended by then."""
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


def _failed(code: int, said: str) -> Iterator[str]:
    if code != 0:
        yield f"ended with {code} undisturbed: {said[-2000:]}"


def _judge_exit(code: int, number: signal.Signals, said: str) -> tuple[str, tuple[str, ...]]:
    if code == -number or said.startswith("Could not import runpy module"):
        return "signal", ()  # a traceback is that of Python, interrupted before our first line
    wrong = []
    if code != CODES[number]:
        wrong.append(f"exit code {code} after {number.name}: {said[-2000:]}")
    if "Traceback" in said or "Error" in said or "xception" in said:
        wrong.append(f"a traceback after {number.name} ({code}): {said[-3000:]}")
    return "code", tuple(wrong)


def _left_behind(folder: Path, scratch: Path) -> Iterator[str]:
    """What should not be there after a command has ended."""
    for path in (*folder.rglob("*.aside"), *scratch.iterdir()):
        yield f"left behind: {path}"
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not _whole(path):
            yield f"half-written: {path}"


def _running() -> set[Path]:
    """The cache folders of running processes, and of processes that were killed."""
    return set(Path(os.environ["SKYSTACK_CACHE"]).rglob(f"{RUNNING}*"))


def _whole(path: Path) -> bool:
    """Whether a file is one that could have been written to its end."""
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
    except Exception:  # each reader has its own
        return False
    ends = {
        ".html": b"</html>",
        ".svg": b"</svg>",
        ".gif": b"\x3b",
        ".png": b"IEND\xae\x42\x60\x82",
    }
    return data.rstrip().endswith(ends.get(path.suffix, b""))


def _orphans(mark: str) -> Iterator[str]:
    """Processes of the command that are still there after a while."""
    deadline = time.monotonic() + ORPHAN_S
    while (there := _marked(mark)) and time.monotonic() < deadline:
        time.sleep(0.1)
    for number, words in there.items():
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
        yield f"still running: {words}"


def _marked(mark: str) -> dict[int, str]:
    found = {}
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and f"{MARK}={mark}".encode() in (
                entry / "environ"
            ).read_bytes().split(b"\0"):
                words = (entry / "cmdline").read_bytes().replace(b"\0", b" ")
                found[int(entry.name)] = words.decode(errors="replace")[-200:]
    return found


def at(moment: float) -> Callable[[], bool]:
    """Due at a moment of the clock."""
    return lambda: time.monotonic() >= moment


class Study:
    """All signals: where they work, how often, and what came of them."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._chance = folder, random.Random(seed)
        evaluation = folder / "known" / "evaluations" / "lateral-s0-skystack-stacked"
        self._known = Place(folder / "known", evaluation, folder / "known" / "run")
        self.counts: dict[str, Counter[str]] = {}
        self.wrong: list[str] = []
        self._took: dict[str, float] = {}

    def prepare(self, names: Sequence[str]) -> None:
        """Run what the others read, and each command until what it compiles is kept."""
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
            sys.stderr.write(f"{name}: {self._took[name]:.1f} s undisturbed\n")

    def signal_all(self, names: Sequence[str], count: int) -> None:
        """So many signals, shared among the commands by their weights."""
        weights = [SIGNALLED[name].weight for name in names]
        for number in range(count):
            name = self._chance.choices(names, weights)[0]
            while not self._once(name, number):
                pass
            if number % 10 == 9:
                sys.stderr.write(f"{number + 1} signals, {len(self.wrong)} wrong\n")
        if "train" in names:
            self._finish_training()
        if any(SIGNALLED[name].has_workers for name in names):
            self._clean_cache()

    def _once(self, name: str, number: int) -> bool:
        """One command; False when it had ended before the signal came."""
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            work = Path(folder) / "work"
            work.mkdir()
            place = self._known._replace(folder=work)
            if name == "train":
                place = self._known._replace(folder=self._folder / "resumed")
                place.folder.mkdir(exist_ok=True)
            which = self._chance.choice(list(CODES))
            to_group = which == signal.SIGINT and self._chance.random() < 0.5
            begun = time.monotonic()
            moment = begun + self._chance.uniform(0.0, self._took[name])
            subject = SIGNALLED[name]
            command = subject.command(place)
            ended = signalled(command, place, which, to_group, at(moment), subject.has_workers)
        self.counts.setdefault(name, Counter())[ended.how] += 1
        if ended.wrong:
            self.counts[name]["wrong"] += 1
            sent = f"{which.name} to {'the group' if to_group else 'it'}"
            self.wrong.append("\n".join((f"signal {number}, {name}, {sent}:", *ended.wrong)))
            sys.stderr.write(self.wrong[-1] + "\n")
        if ended.how == "before":  # the machine has become less busy
            self._took[name] = min(self._took[name], time.monotonic() - begun)
            if name == "train":
                self._finish_training()
        return ended.how != "before"

    def _clean_cache(self) -> None:
        """Check that a later command deletes what killed workers left in the cache."""
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
            self.wrong.append("a training that was resumed came to another end")
        place.folder.rename(self._folder / f"finished-{time.monotonic_ns()}")


def main() -> int:
    """Returns the exit code: 0 all as it should be, 1 something was not."""
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
            f"{counts['signal']} by the signal itself, {counts['wrong']} wrong\n"
        )
    for wrong in study.wrong:
        sys.stdout.write(f"{wrong}\n")
    return 1 if study.wrong else 0


def _bluebird() -> bool:
    return find_spec("bluebird_dt") is not None and find_spec("pebble") is not None


if __name__ == "__main__":
    sys.exit(main())
