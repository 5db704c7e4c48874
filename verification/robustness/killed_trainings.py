"""Kill training runs or small reproductions repeatedly: the results must not change.

    python -m verification.robustness.killed_trainings [--kills N] [--seed S] [--what reproduction]

Each result is compared with an undisturbed run: the policies and all fields of `metrics.jsonl`
except `wall_s` must be bit-identical. Half of the kills (SIGKILL) come at a random moment,
including start-up; the other half as soon as a temporary file appears. A training run is then
resumed with a full disk (a limit on the size of its files) and with a read-only folder: each must
end with a one-line error and leave the checkpoint unchanged. Prints the counts; exit code 1 if
there is a difference.
"""

import argparse
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

UPDATES = 40
SETTINGS = (
    f"ppo.total_steps={UPDATES * 256}",
    "ppo.environments=8",
    "ppo.steps=32",
    "ppo.minibatch=64",
    "ppo.epochs=1",
    f"pretraining.steps={UPDATES * 128}",  # two phases
)
CHECKPOINT = "checkpoint/learner.safetensors"
LIMIT_S = 300.0

REPRODUCTION = """
import sys
from pathlib import Path
from skystack.io.locks import locked_folder
from skystack.learning.experiment import load_experiment
from skystack.compilation.programs import compile_for_cores
from skystack.reproduction.plan import OWN_FOLDERS, Plan
from skystack.reproduction.run import run_plan

if __name__ == "__main__":
    out, name, seeds, *settings = sys.argv[1:]
    out = Path(out)
    compile_for_cores(1)
    with locked_folder(out, OWN_FOLDERS):
        experiments = (load_experiment(name, settings),)
        plan = Plan(experiments, int(seeds), 3, out, False, "", checkpoint_every_s=0.0)
        run_plan(plan, lambda name, progress: None)
"""

READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'


class DifferentError(Exception):
    """A killed command gave another result."""


class Subject(NamedTuple):
    """A kind of command to kill."""

    command: Callable[[Path], list[str]]
    metrics: str
    """The pattern of the metrics files of its training runs."""
    faults: bool
    """Whether it is also tested with a full disk and a read-only folder."""


def train_command(folder: Path) -> list[str]:
    """A small training run with a checkpoint at every update, resumed if there is one."""
    changes = [word for setting in SETTINGS for word in ("--set", setting)]
    words = ["train", "lateral-best", "--resume", "--checkpoint-every", "0", "--out", str(folder)]
    return [sys.executable, "-m", "skystack", *words, *changes]


def reproduce_command(
    folder: Path,
    experiment: str = "lateral-best",
    seeds: int = 2,
    settings: Sequence[str] = SETTINGS,
) -> list[str]:
    """Small training runs in separate processes, evaluated on three scenarios."""
    return [sys.executable, "-c", REPRODUCTION, str(folder), experiment, str(seeds), *settings]


SUBJECTS = {
    "training": Subject(train_command, "metrics.jsonl", faults=True),
    "reproduction": Subject(reproduce_command, "train/*/metrics.jsonl", faults=False),
}


def outcome(subject: Subject, folder: Path) -> list[tuple[bytes, list[dict[str, Any]]]]:
    """The policy and the metrics of each training run, without `wall_s`."""
    found = []
    for path in sorted(folder.glob(subject.metrics)):
        lines = path.read_text().splitlines()
        metrics = [json.loads(line) | {"wall_s": None} for line in lines]
        if [line["update"] for line in metrics] != list(range(1, UPDATES + 1)):
            raise DifferentError(f"{path}: has a gap or a duplicate")
        found.append(((path.parent / "policy.safetensors").read_bytes(), metrics))
    return found


def finish(command: Sequence[str], limit_s: float = LIMIT_S) -> float:
    """Run a command to its end; returns the time it took, in seconds."""
    started = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=False)
    if done.returncode != 0:
        raise DifferentError(f"{command}: exited with {done.returncode}: {done.stderr[-2000:]}")
    return time.monotonic() - started


def killed(command: Sequence[str], due: Callable[[], bool]) -> bool:
    """Start a command and kill it when that is due; False if it had ended before."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while process.poll() is None and not due():
        time.sleep(0.0002)
    process.kill()
    _, stderr = process.communicate()
    if process.returncode > 0:
        raise DifferentError(f"exited with {process.returncode}: {stderr.decode()[-2000:]}")
    return process.returncode < 0


def at(moment: float) -> Callable[[], bool]:
    """Due at a time of the monotonic clock."""
    return lambda: time.monotonic() >= moment


def writing(folder: Path, skipped: int) -> Callable[[], bool]:
    """Due when a temporary file is seen, after `skipped` others."""
    seen: set[str] = set()

    def due() -> bool:
        names = (name for _, _, names in os.walk(folder) for name in names)
        seen.update(name for name in names if name.endswith(".aside"))
        return len(seen) > skipped

    return due


def check_faults(folder: Path) -> list[str]:
    """Resume a training with a full disk and a read-only folder; returns what was not tested."""
    checkpoint = folder / CHECKPOINT
    size = checkpoint.stat().st_size // 2

    def limit_file_size() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    _check_refusal(train_command(folder), checkpoint, limit_file_size)
    if os.geteuid() != 0:
        return ["read-only folder: needs root, to mount it"]
    read_only = ["unshare", "--mount", "sh", "-c", READ_ONLY, str(folder)]
    try:
        subprocess.run([*read_only, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return ["read-only folder: this system does not permit mounting"]
    _check_refusal([*read_only, *train_command(folder)], checkpoint)
    return []


def _check_refusal(
    command: Sequence[str], checkpoint: Path, prepare: Callable[[], None] | None = None
) -> None:
    before = checkpoint.read_bytes()
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=LIMIT_S, check=False, preexec_fn=prepare
    )
    lines = done.stderr.splitlines()[-1:]
    clear = lines and lines[0].startswith("skystack: ") and "Traceback" not in done.stderr
    if done.returncode != 2 or not clear or " written" not in lines[0]:
        raise DifferentError(
            f"no clear refusal, exit code {done.returncode}: {done.stderr[-2000:]}"
        )
    if checkpoint.read_bytes() != before:
        raise DifferentError(f"{checkpoint}: was changed by a training that could not write")


class Done(NamedTuple):
    """The counts of all kills."""

    kills: int
    while_writing: int
    """The number of kills that left a half-written file."""
    trainings: int
    not_tested: list[str]


def survive(subject: Subject, kills: int, seed: int, out: Path) -> Done:
    """Kill and resume until the number of kills is reached.

    Raises DifferentError if a result differs.
    """
    generator = random.Random(seed)
    undisturbed = out / "undisturbed"
    finish(subject.command(undisturbed))  # compiles
    expected = outcome(subject, undisturbed)
    again_s = finish(subject.command(out / "again"))
    if not expected or outcome(subject, out / "again") != expected:
        raise DifferentError("two undisturbed runs differ")
    count, while_writing, trainings = 0, 0, 0
    not_tested: list[str] = []
    while count < kills:
        folder = out / f"killed-{trainings}"
        command, unfinished = subject.command(folder), True
        while unfinished and count < kills:
            random_moment = at(time.monotonic() + generator.uniform(0.0, again_s))
            unfinished = killed(
                command,
                random_moment
                if generator.random() < 0.5
                else writing(folder, generator.randrange(25)),
            )
            count += unfinished
            while_writing += unfinished and any(folder.rglob("*.aside"))
        if subject.faults and not trainings and (folder / CHECKPOINT).exists():
            not_tested = check_faults(folder)
        if unfinished:
            finish(command)
        if outcome(subject, folder) != expected:
            raise DifferentError(
                f"{folder}: differs from the undisturbed run (seed {seed}, {count} kills)"
            )
        trainings += 1
        sys.stderr.write(
            f"{count} kills, {while_writing} of them while writing, {trainings} identical runs\n"
        )
    return Done(count, while_writing, trainings, not_tested)


def main() -> int:
    """Returns the exit code: 0 all results are identical, 1 one differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--what", choices=list(SUBJECTS), default="training")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="killed-") as folder:
        os.environ.setdefault("SKYSTACK_CACHE", f"{folder}/programs")
        try:
            done = survive(SUBJECTS[options.what], options.kills, options.seed, Path(folder))
        except DifferentError as error:
            sys.stdout.write(f"{error}\n")
            return 1
    sys.stdout.write(
        f"{done.kills} kills, {done.while_writing} of them while a file was being written: all "
        f"{done.trainings} runs of {options.what} gave the same result\n"
        + "".join(f"not tested: {what}\n" for what in done.not_tested)
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
