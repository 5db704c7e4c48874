"""Kill a training, or a small reproduction, again and again: each must come to the same end.

    python -m verification.robustness.killed_trainings [--kills N] [--seed S] [--what reproduction]

Each is compared with one that nobody disturbed: the policies and all fields of `metrics.jsonl` but
`wall_s` must be the same bit for bit. Half of the kills (SIGKILL) come at a random moment of the
run, starting included, half as soon as a file that is being written appears. A training then meets
a disk that takes no more (a limit on the size of its files) and a read-only folder: each must end
in one line and leave the checkpoint as it was. Prints what was done; exit code 1 at a difference.
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
from skystack.compilation.programs import compile_for_one_core
from skystack.reproduction.plan import OWN_FOLDERS, Plan
from skystack.reproduction.run import run_plan

if __name__ == "__main__":
    out, name, seeds, *settings = sys.argv[1:]
    out = Path(out)
    compile_for_one_core()
    with locked_folder(out, OWN_FOLDERS):
        experiments = (load_experiment(name, settings),)
        plan = Plan(experiments, int(seeds), 3, out, False, "", checkpoint_every_s=0.0)
        run_plan(plan, lambda name, progress: None)
"""

READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'


class DifferentError(Exception):
    """Something did not survive."""


class Subject(NamedTuple):
    """What is killed."""

    command: Callable[[Path], list[str]]
    metrics: str
    """Pattern of the metrics of its trainings."""
    faults: bool
    """Whether it meets full disks and read-only folders too."""


def train_command(folder: Path) -> list[str]:
    """A small training with a checkpoint at every update, gone on with where there is one."""
    changes = [word for setting in SETTINGS for word in ("--set", setting)]
    words = ["train", "lateral-best", "--resume", "--checkpoint-every", "0", "--out", str(folder)]
    return [sys.executable, "-m", "skystack", *words, *changes]


def reproduce_command(
    folder: Path,
    experiment: str = "lateral-best",
    seeds: int = 2,
    settings: Sequence[str] = SETTINGS,
) -> list[str]:
    """Small trainings in processes of their own, judged on three scenarios."""
    return [sys.executable, "-c", REPRODUCTION, str(folder), experiment, str(seeds), *settings]


SUBJECTS = {
    "training": Subject(train_command, "metrics.jsonl", faults=True),
    "reproduction": Subject(reproduce_command, "train/*/metrics.jsonl", faults=False),
}


def outcome(subject: Subject, folder: Path) -> list[tuple[bytes, list[dict[str, Any]]]]:
    """Of each training its policy and metrics, but for `wall_s`."""
    found = []
    for path in sorted(folder.glob(subject.metrics)):
        lines = path.read_text().splitlines()
        metrics = [json.loads(line) | {"wall_s": None} for line in lines]
        if [line["update"] for line in metrics] != list(range(1, UPDATES + 1)):
            raise DifferentError(f"{path}: has a gap or a double")
        found.append(((path.parent / "policy.safetensors").read_bytes(), metrics))
    return found


def finish(command: Sequence[str], limit_s: float = LIMIT_S) -> float:
    """Run to the end; returns how long it took, in seconds."""
    begun = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=False)
    if done.returncode != 0:
        raise DifferentError(f"{command}: ended with {done.returncode}: {done.stderr[-2000:]}")
    return time.monotonic() - begun


def killed(command: Sequence[str], due: Callable[[], bool]) -> bool:
    """Start it and kill it as soon as it is due; False if it had ended by then."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while process.poll() is None and not due():
        time.sleep(0.0002)
    process.kill()
    _, said = process.communicate()
    if process.returncode > 0:
        raise DifferentError(f"ended with {process.returncode}: {said.decode()[-2000:]}")
    return process.returncode < 0


def at(moment: float) -> Callable[[], bool]:
    """Due at a moment of the clock."""
    return lambda: time.monotonic() >= moment


def writing(folder: Path, skipped: int) -> Callable[[], bool]:
    """Due when a file that is being written is seen for the so many-th time."""
    seen: set[str] = set()

    def due() -> bool:
        names = (name for _, _, names in os.walk(folder) for name in names)
        seen.update(name for name in names if name.endswith(".aside"))
        return len(seen) > skipped

    return due


def meet_faults(folder: Path) -> list[str]:
    """A full disk and a read-only folder, in the middle of a training; returns what was not met."""
    checkpoint = folder / CHECKPOINT
    size = checkpoint.stat().st_size // 2

    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    _refused(train_command(folder), checkpoint, little_room)
    if os.geteuid() != 0:
        return ["read-only folder: only as root, by a mount"]
    alone = ["unshare", "--mount", "sh", "-c", READ_ONLY, str(folder)]
    try:
        subprocess.run([*alone, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return ["read-only folder: this system lets nobody mount"]
    _refused([*alone, *train_command(folder)], checkpoint)
    return []


def _refused(
    command: Sequence[str], checkpoint: Path, prepare: Callable[[], None] | None = None
) -> None:
    before = checkpoint.read_bytes()
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=LIMIT_S, check=False, preexec_fn=prepare
    )
    said = done.stderr.splitlines()[-1:]
    clear = said and said[0].startswith("skystack: ") and "Traceback" not in done.stderr
    if done.returncode != 2 or not clear or " written" not in said[0]:
        raise DifferentError(
            f"no clear refusal, exit code {done.returncode}: {done.stderr[-2000:]}"
        )
    if checkpoint.read_bytes() != before:
        raise DifferentError(f"{checkpoint}: changed by a training that could not write")


class Done(NamedTuple):
    """What was survived."""

    kills: int
    while_writing: int
    """Kills that left a half-written file."""
    trainings: int
    not_met: list[str]


def survive(subject: Subject, kills: int, seed: int, out: Path) -> Done:
    """Kill and go on, until so many kills are survived. Raises DifferentError where one is not."""
    chance = random.Random(seed)
    undisturbed = out / "undisturbed"
    finish(subject.command(undisturbed))  # compiles
    expected = outcome(subject, undisturbed)
    again_s = finish(subject.command(out / "again"))
    if not expected or outcome(subject, out / "again") != expected:
        raise DifferentError("two undisturbed runs differ")
    count, left, trainings = 0, 0, 0
    not_met: list[str] = []
    while count < kills:
        folder = out / f"killed-{trainings}"
        command, going_on = subject.command(folder), True
        while going_on and count < kills:
            random_moment = at(time.monotonic() + chance.uniform(0.0, again_s))
            going_on = killed(
                command,
                random_moment if chance.random() < 0.5 else writing(folder, chance.randrange(25)),
            )
            count += going_on
            left += going_on and any(folder.rglob("*.aside"))
        if subject.faults and not trainings and (folder / CHECKPOINT).exists():
            not_met = meet_faults(folder)
        if going_on:
            finish(command)
        if outcome(subject, folder) != expected:
            raise DifferentError(
                f"{folder}: another end than undisturbed (seed {seed}, {count} kills)"
            )
        trainings += 1
        sys.stderr.write(
            f"{count} kills, {left} of them while writing, {trainings} runs the same\n"
        )
    return Done(count, left, trainings, not_met)


def main() -> int:
    """Returns the exit code: 0 all survived, 1 something did not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--what", choices=list(SUBJECTS), default="training")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="killed-") as folder:
        os.environ.setdefault("SKYSTACK_CACHE", f"{folder}/programs")
        try:
            done = survive(SUBJECTS[options.what], options.kills, options.seed, Path(folder))
        except DifferentError as wrong:
            sys.stdout.write(f"{wrong}\n")
            return 1
    sys.stdout.write(
        f"{done.kills} kills survived, {done.while_writing} of them while a file was written: "
        f"{done.trainings} runs of {options.what} came to the same end\n"
        + "".join(f"not met: {what}\n" for what in done.not_met)
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
