"""Check that a reproduction depends neither on the number of cores nor on cached programs.

    python -m verification.robustness.same_result

Makes a small reproduction with one worker per core, then again on one core, first with the cached
programs of the first, then without a cache. Policies, metrics, tables and results must be equal
except for times; exit code 1 if they are not.
"""

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from verification.robustness.killed_trainings import finish, reproduce_command

FILES = (
    "results.json",
    "train/*/config.toml",
    "train/*/metrics.jsonl",
    "train/*/policy.safetensors",
    "evaluation/*/*.parquet",
)
"""The compared files of a reproduction: all except those with only times, or hashes of times."""
OF_THE_RUN = ("wall_s", "steps_per_s", "machine")
"""Fields that describe the run, not its result."""
WAYS = {"one core, cached programs": "programs", "one core, no cache": "off"}
"""The ways in which it is repeated, and their cache folders."""


class Again(NamedTuple):
    """A repeated reproduction."""

    way: str
    files: int
    different: list[str]
    """The files that differ from those of the first reproduction."""


def contents(run: Path) -> dict[str, Any]:
    """The results of a reproduction by file: bytes, or JSON without the fields `OF_THE_RUN`."""
    found = {}
    for path in (each for pattern in FILES for each in sorted(run.glob(pattern))):
        whole: Any = path.read_bytes()
        if path.suffix in (".json", ".jsonl"):
            lines = whole.splitlines() if path.suffix == ".jsonl" else [whole]
            whole = [_result_of(json.loads(line)) for line in lines]
        found[str(path.relative_to(run))] = whole
    return found


def _result_of(read: Any) -> Any:
    if isinstance(read, dict):
        return {key: _result_of(each) for key, each in read.items() if key not in OF_THE_RUN}
    return [_result_of(each) for each in read] if isinstance(read, list) else read


def made_again(out: Path, ways: dict[str, str]) -> Iterator[Again]:
    """Make a reproduction, then repeat it in each of the ways."""
    expected = _made(out / "first", "programs", [])
    one_core = ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0)))]
    for way, programs in ways.items():
        again = _made(out / way, programs, one_core)
        names = sorted(expected.keys() | again.keys())
        different = [name for name in names if expected.get(name) != again.get(name)]
        yield Again(way, len(names), different)


def _made(folder: Path, programs: str, prefix: list[str]) -> dict[str, Any]:
    cache = programs if programs == "off" else str(folder.parent / programs)
    finish(["env", f"SKYSTACK_CACHE={cache}", *prefix, *reproduce_command(folder)])
    return contents(folder)


def main() -> int:
    """Returns the exit code: 0 all files are equal, 1 a file differs."""
    same = True
    with tempfile.TemporaryDirectory(prefix="same-") as folder:
        for again in made_again(Path(folder), WAYS):
            count = f"{len(again.different)} of {again.files} files differ"
            sys.stdout.write(f"{again.way}: {count}\n")
            sys.stdout.writelines(f"  {name}\n" for name in again.different)
            same &= not again.different
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
