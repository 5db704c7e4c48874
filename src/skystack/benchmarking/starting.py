"""Start-up times: whole commands, each in its own process."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from skystack.benchmarking.figures import Figure
from skystack.compilation.programs import CACHE_VARIABLE
from skystack.errors import TrainingError

FIRST_UPDATE = ("train", "lateral", "--set", "ppo.total_steps=8192", "--out")


def starting_figures(repetitions: int) -> list[Figure]:
    """Help, import, and the first update of a training, without and with cached programs."""
    imports = [_seconds(["-c", "import skystack.learning.run"]) for _ in range(repetitions)]
    helps = [_seconds(["-m", "skystack", "--help"]) for _ in range(repetitions)]
    cold, warm = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(repetitions):
            out, cache = f"{folder}/{number}", f"{folder}/cache-{number}"
            train = ["-m", "skystack", *FIRST_UPDATE]
            cold.append(_seconds([*train, f"{out}-cold"], cache))
            warm.append(_seconds([*train, f"{out}-warm"], cache))
    update = f"`skystack {' '.join(FIRST_UPDATE[:-1])}`, start to end"
    return [
        Figure("skystack --help", "s", tuple(helps), "whole process"),
        Figure("import of the trainer", "s", tuple(imports), "whole process"),
        Figure("first update, cold", "s", tuple(cold), f"{update}, no cached programs"),
        Figure("first update, warm", "s", tuple(warm), f"{update}, with cached programs"),
    ]


def _seconds(arguments: list[str], cache: str = "off") -> float:
    started = time.perf_counter()
    environment = os.environ | {CACHE_VARIABLE: cache}
    process = subprocess.run(
        [sys.executable, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        cwd=Path.cwd(),
    )
    if process.returncode != 0:
        raise TrainingError(f"{' '.join(arguments)}: {last_line(process.stderr)}")
    return time.perf_counter() - started


def last_line(text: str) -> str:
    """The last line of what a command printed, where it states its error; empty if none."""
    return ["", *text.strip().splitlines()][-1]
