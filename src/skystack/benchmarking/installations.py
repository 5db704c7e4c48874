"""`skystack bench` of this version and of another installed one, run as commands."""

import math
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

import skystack
from skystack.benchmarking.figures import Figure
from skystack.benchmarking.machine import Machine
from skystack.benchmarking.starting import last_line
from skystack.errors import InputError, TrainingError

CHECK_S = 60.0
"""The time within which the other Python must print the help of `skystack bench`."""
END_S = 10.0
"""The time that a measurement has to end after an interruption."""
_IMPORT_VARIABLES = ("PYTHONPATH", "PYTHONHOME")
"""Environment variables that could make the other Python import our packages."""
_ALLOWED = (
    "(allowed: the Python of an environment with a skystack that has `bench --only`, such as "
    "../before/.venv/bin/python)"
)


class Bench(NamedTuple):
    """What one run of `skystack bench` measured."""

    machine: Machine
    figures: list[Figure]


class _PrintedFigure(msgspec.Struct):
    name: str
    unit: str
    values: tuple[float | None, ...]
    """None for training runs that did not reach success."""
    configuration: str

    @property
    def figure(self) -> Figure:
        values = tuple(math.inf if value is None else value for value in self.values)
        return Figure(self.name, self.unit, values, self.configuration)


class _Printed(msgspec.Struct):
    """The JSON of `skystack bench`, as far as it is needed."""

    machine: Machine
    figures: list[_PrintedFigure]


def check_python(python: str, groups: Sequence[str], options: Sequence[str]) -> None:
    """Raises InputError unless a Python has a skystack that can measure these groups."""
    where = f"--against {python}"
    if not python or Path(python).is_dir():
        raise InputError(f"{where}: is {'a folder' if python else 'empty'} {_ALLOWED}")
    arguments = [*options, "--only", *groups, "--help"]
    try:
        code, out, err = _run(python, arguments, CHECK_S)
    except OSError as error:
        raise InputError(f"{where}: {error.strerror} {_ALLOWED}") from None
    except subprocess.TimeoutExpired:
        raise InputError(f"{where}: no answer in {CHECK_S:.0f} s {_ALLOWED}") from None
    if code:
        raise InputError(f"{where}: {last_line(err) or f'exit code {code}'} {_ALLOWED}")
    if "--only" not in out:
        raise InputError(f"{where}: no `bench --only` {_ALLOWED}")


def bench_of(python: str | None, group: str, options: Sequence[str]) -> Bench:
    """What `skystack bench` measures of a group, with our own Python (None) or another one.

    Raises TrainingError if it fails.
    """
    where = f"bench --only {group}" if python is None else f"--against {python}, {group}"
    code, out, err = _run(python, ["--json", *options, "--only", group])
    if code:
        raise TrainingError(f"{where}: {last_line(err) or 'no message'} (exit code {code})")
    try:
        printed = msgspec.json.decode(out, type=_Printed)
    except msgspec.MsgspecError as error:
        raise TrainingError(f"{where}: not the JSON of `skystack bench`: {error}") from None
    return Bench(printed.machine, [each.figure for each in printed.figures])


def _run(
    python: str | None, arguments: Sequence[str], time_limit_s: float | None = None
) -> tuple[int, str, str]:
    """Run `skystack bench` with our own Python (None) or another one.

    Returns the exit code, the standard output and the standard error. After an interruption, the
    command gets time to clean up.
    """
    environment = os.environ | {"PYTHONSAFEPATH": "1"}  # a folder named skystack is not imported
    if python is None:
        ours = str(Path(skystack.__file__).parents[1])
        paths = filter(None, (ours, os.environ.get("PYTHONPATH")))
        environment["PYTHONPATH"] = os.pathsep.join(paths)
    else:
        for name in _IMPORT_VARIABLES:
            environment.pop(name, None)
    interpreter = sys.executable if python is None else python
    with subprocess.Popen(
        [interpreter, "-m", "skystack", "bench", *arguments],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="backslashreplace",
    ) as process:
        try:
            out, err = process.communicate(timeout=time_limit_s)
        except BaseException:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
            raise
    return process.returncode, out, err
