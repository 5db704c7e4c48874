"""Compare shipped policies on other processors: the clearances, and the numbers on their cards.

    python -m verification.robustness.other_processors [POLICY ...] [--episodes N]

Without a POLICY: all that ship. Each is evaluated stacked, on this processor and as on older ones,
for which XLA uses fewer instructions (x86-64 only) and so rounds differently. With 1,000 scenarios,
the row on this processor is also compared with the record next to the policy. Prints a table; exit
code 1 if a difference is larger than docs/reliability.md promises.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skystack.evaluation.agreement import same_clearances
from skystack.evaluation.summary import summarise
from skystack.policies.measured import read_measured
from skystack.policies.shipped import SHIPPED, scenario_policies

PROCESSORS = {"SSE4.2": "SSE4_2", "AVX": "AVX", "AVX2": "AVX2"}
"""XLA's names of the instruction sets that it is limited to."""
LEAST_SAME = 0.99
"""Promised: the least share of identical scenarios; rates differ by at most 1 minus this."""
MAX_APART_NM = 0.01
"""Promised: the largest distance between the same aircraft in identical scenarios."""
MEANS = {"clearances_mean": 0.01, "instructions_mean": 0.01}
"""Promised for a recorded row: the largest relative difference of a mean."""
RATES = ("success_rate", "correct_exit_rate", "excursion_rate", "few_clearances_rate")


class Likeness(NamedTuple):
    """How similar two evaluations of the same scenarios are."""

    same: int
    """The number of scenarios with the same clearances in the same cycles and the same outcomes."""
    scenarios: int
    apart_nm: float
    """The largest distance between the same aircraft in those scenarios."""

    @property
    def holds(self) -> bool:
        """Whether the promise is kept."""
        return self.same >= LEAST_SAME * self.scenarios and self.apart_nm <= MAX_APART_NM


def flown(policy: str, episodes: int, out: Path, most: str | None = None) -> Path:
    """Evaluate a shipped policy in a new process limited to the instruction set `most`.

    Returns the folder of its tables.
    """
    flags = os.environ.get("XLA_FLAGS", "") + (f" --xla_cpu_max_isa={most}" if most else "")
    words = ["evaluate", policy, "--episodes", str(episodes), "--out", str(out)]
    environment = os.environ | {"XLA_FLAGS": flags, "SKYSTACK_CACHE": "off"}
    command = [sys.executable, "-m", "skystack", *words]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    (tables,) = out.glob(f"{policy}-s*")
    return tables


def likeness(ours: Path, theirs: Path) -> Likeness:
    """Compare the tables of two evaluations."""
    episodes, clearances = (
        [pq.read_table(folder / f"{name}.parquet") for folder in (ours, theirs)]
        for name in ("episodes", "clearances")
    )
    numbers = episodes[0]["scenario"].to_pylist()
    same = np.array(same_clearances(clearances[0], clearances[1], numbers, cycles=0))
    for field in episodes[0].schema:
        if not pa.types.is_floating(field.type):
            first, second = (table[field.name].to_numpy() for table in episodes)
            same &= first == second
    kept = np.array(numbers)[same]
    first, second = (_positions_nm(folder, kept) for folder in (ours, theirs))
    apart_nm = float(np.max(np.hypot(*(first - second)), initial=0.0))
    return Likeness(int(same.sum()), len(same), apart_nm)


def _positions_nm(folder: Path, scenarios: np.ndarray) -> np.ndarray:
    """Positions north and east. A minute of arc is a mile, because the sector is on the equator."""
    table = pq.read_table(folder / "trajectories.parquet", columns=["scenario", "lat", "lon"])
    chosen = np.isin(table["scenario"].to_numpy(), scenarios)
    return np.array([table[name].to_numpy()[chosen] * 60.0 for name in ("lat", "lon")])


def deviations_from_record(policy: str, tables: Path) -> list[str]:
    """The numbers of an evaluation that differ too much from the record next to the policy."""
    measured = read_measured(SHIPPED / policy)
    if measured is None or (recorded := measured.stacked) is None:
        return ["no record"]
    episodes = pq.read_table(tables / "episodes.parquet")
    row = summarise(policy, "", 0, "", True, True, 0.0, episodes)
    allowed = {name: part * recorded[name] for name, part in MEANS.items()}
    allowed |= dict.fromkeys(RATES, 1.0 - LEAST_SAME)
    return [
        f"{name} is {row[name]:.6g} (recorded: {recorded[name]:.6g})"
        for name, most in allowed.items()
        if abs(row[name] - recorded[name]) > most
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 all promises are kept, 1 one is not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("policies", nargs="*", metavar="POLICY")
    parser.add_argument("--episodes", type=int, default=1000)
    options = parser.parse_args(arguments)
    holds = True
    sys.stdout.write(
        "| policy | processor | identical | of | distance, NM |\n|---|---|---:|---:|---:|\n"
    )
    for policy in options.policies or scenario_policies():
        with tempfile.TemporaryDirectory(prefix="processors-") as folder:
            here = flown(policy, options.episodes, Path(folder, "here"))
            for name, most in PROCESSORS.items():
                found = likeness(here, flown(policy, options.episodes, Path(folder, name), most))
                cells = (policy, name, found.same, found.scenarios, f"{found.apart_nm:.4f}")
                sys.stdout.write(f"| {' | '.join(map(str, cells))} |\n")
                sys.stdout.flush()
                holds &= found.holds
            if options.episodes == 1000:
                for line in deviations_from_record(policy, here):
                    sys.stdout.write(f"{policy}: {line}\n")
                    holds = False
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
