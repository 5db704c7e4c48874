"""Compare the results of two installations: tables, weights and metrics, bit for bit.

    python -m verification.robustness.same_behaviour OTHER_PYTHON [--episodes N] [--steps N]

For changes that must not affect behaviour. Runs the same commands with this interpreter and with
another one, in whose environment the other version is installed. Every shipped policy is evaluated
plain and stacked, some also sampled, exported, in another sector or on another platform; every
shipped experiment is trained for some steps; and the example scenarios are simulated. Exit code 1
if anything differs.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq

from skystack.learning.experiment import experiment_names
from skystack.policies.shipped import scenario_policies

EXAMPLES = Path(__file__).parents[2] / "examples"
OLD_VALUES = {"strayed": "excursion"}
"""Values of text columns in older versions, with their current names."""
SEED = 3


def commands(folder: Path, episodes: int, steps: int) -> Iterator[list[str]]:
    """The commands whose results are compared; they write into a folder."""
    few = str(max(episodes // 2, 1))
    tables = ["--out", str(folder / "evaluation")]
    for policy in scenario_policies():
        for way in ("--stacking", "--no-stacking"):
            yield ["evaluate", policy, "--episodes", str(episodes), way, *tables]
    sampled = ["--sample", "--out", str(folder / "sampled")]
    yield ["evaluate", "lateral", "--episodes", few, *sampled]
    elsewhere = ["--sector", "highland", "--cycles", "500", "--out", str(folder / "highland")]
    yield ["evaluate", "lateral-best", "--episodes", few, *elsewhere]
    for policy, platform in (("lateral", "bluebird"), ("vertical", "bluesky")):
        yield ["evaluate", policy, "--episodes", "4", "--platform", platform, *tables]
    exported = str(folder / "policy.onnx")
    yield ["export", "lateral-best", "--format", "onnx", "-o", exported]
    yield ["evaluate", exported, "--episodes", few, "--out", str(folder / "exported")]
    for name in experiment_names():
        yield [
            *("train", name, "--seed", str(SEED), "--set", f"ppo.total_steps={steps}"),
            *("--out", str(folder / "train" / name)),
        ]
    for scenario in sorted(EXAMPLES.glob("*.json")):
        yield ["simulate", str(scenario), "-o", str(folder / f"{scenario.stem}.parquet")]


def digests(python: str, episodes: int, steps: int) -> dict[str, str]:
    """The results of the commands under one interpreter, by file and column."""
    found: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="same-") as name:
        folder = Path(name)
        for command in commands(folder, episodes, steps):
            subprocess.run([python, "-m", "skystack", *command], check=True, capture_output=True)
        for path in sorted(folder.rglob("*")):
            for part, value in _parts(path):
                found[f"{path.relative_to(folder)} {part}".strip()] = value
    return found


def _parts(path: Path) -> Iterator[tuple[str, str]]:
    """The parts of a file that are compared, each with its digest."""
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        for name in table.column_names:
            values = [OLD_VALUES.get(each, each) for each in table[name].to_pylist()]
            yield name, _digest(repr(values).encode())
    elif path.name == "policy.safetensors":
        yield "", _digest(path.read_bytes())
    elif path.name == "metrics.jsonl":
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        compared = [{key: line[key] for key in sorted(line) if key != "wall_s"} for line in lines]
        yield "", _digest(json.dumps(compared).encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def different(first: dict[str, str], second: dict[str, str]) -> list[str]:
    """The parts that differ, or that exist only once."""
    names = sorted(first.keys() | second.keys())
    return [name for name in names if first.get(name) != second.get(name)]


def main() -> int:
    """Returns the exit code: 0 if all is identical, 1 if anything differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("other", metavar="OTHER_PYTHON")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--steps", type=int, default=50_000)
    options = parser.parse_args()
    ours, theirs = (
        digests(python, options.episodes, options.steps)
        for python in (sys.executable, options.other)
    )
    differing = different(ours, theirs)
    sys.stdout.write(f"{len(differing)} of {len(ours.keys() | theirs.keys())} parts differ\n")
    sys.stdout.writelines(f"  {name}\n" for name in differing)
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
