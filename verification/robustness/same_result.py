"""Two reproductions of the same seeds come to the same, whatever cores and kept programs there are.

    python -m verification.robustness.same_result

Makes a small reproduction, with a worker a core, then makes it again on one core, first with the
programs that the other kept, then with none kept. Policies, metrics, tables and results must be
equal but for times; exit code 1 where one is not.
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
"""Of a reproduction: all but what holds times alone, or hashes of what holds them."""
OF_THE_RUN = ("wall_s", "steps_per_s", "machine")
"""Fields that tell of the run, not of the result."""
WAYS = {"one core, kept programs": "programs", "one core, none kept": "off"}
"""How it is made again, and where programs are kept."""


class Again(NamedTuple):
    """A reproduction made again."""

    way: str
    files: int
    other: list[str]
    """Files that are not those of the first."""


def contents(run: Path) -> dict[str, Any]:
    """What a reproduction came to, by file: bytes, or JSON without what tells of the run."""
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
    """A reproduction, made anew in each of the ways."""
    expected = _made(out / "first", "programs", [])
    one_core = ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0)))]
    for way, programs in ways.items():
        again = _made(out / way, programs, one_core)
        names = sorted(expected.keys() | again.keys())
        other = [name for name in names if expected.get(name) != again.get(name)]
        yield Again(way, len(names), other)


def _made(folder: Path, programs: str, on: list[str]) -> dict[str, Any]:
    kept = programs if programs == "off" else str(folder.parent / programs)
    finish(["env", f"SKYSTACK_CACHE={kept}", *on, *reproduce_command(folder)])
    return contents(folder)


def main() -> int:
    """Returns the exit code: 0 all the same, 1 something was not."""
    same = True
    with tempfile.TemporaryDirectory(prefix="same-") as folder:
        for again in made_again(Path(folder), WAYS):
            found = f"{len(again.other)} of {again.files} files differ"
            sys.stdout.write(f"{again.way}: {found}\n")
            sys.stdout.writelines(f"  {name}\n" for name in again.other)
            same &= not again.other
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
