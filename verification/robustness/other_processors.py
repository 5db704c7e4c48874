"""Shipped policies on other processors: the same clearances, and the numbers of their cards.

    python -m verification.robustness.other_processors [POLICY ...] [--episodes N]

Without a POLICY: all that ship. Each is flown stacked, in processes of its own, on this processor
and as on older ones: XLA is allowed fewer instructions (x86-64 only), so that it rounds otherwise.
On this one its row is held to what is recorded beside it, if all 1,000 scenarios are flown. Prints
a table; exit code 1 where something is further apart than docs/reliability.md promises.
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
from skystack.policies.shipped import SHIPPED, shipped_policies

PROCESSORS = {"SSE4.2": "SSE4_2", "AVX": "AVX", "AVX2": "AVX2"}
"""The most that XLA may use, by the name that it has there."""
LEAST_SAME = 0.99
"""Promised: the part of the scenarios that are the same, and how near rates stay."""
OFTEN_TIPPED = {"avoidance-tuned": 0.9}
"""Less is promised of a policy that is often undecided between two answers."""
MOST_APART_NM = 0.01
"""Promised: how near every aircraft of those stays."""
MEANS = {"clearances_mean": 0.01, "instructions_mean": 0.01}
"""Promised of a recorded row: how near a mean stays, as a part of it."""
RATES = ("success_rate", "correct_exit_rate", "excursion_rate", "few_clearances_rate")


class Likeness(NamedTuple):
    """How alike two evaluations of the same scenarios are."""

    same: int
    """Scenarios with the same clearances in the same cycles and all the same outcomes."""
    scenarios: int
    apart_nm: float
    """Greatest distance between an aircraft and itself in those."""

    def holds(self, policy: str) -> bool:
        """Whether it is what is promised of a policy."""
        least = OFTEN_TIPPED.get(policy, LEAST_SAME)
        return self.same >= least * self.scenarios and self.apart_nm <= MOST_APART_NM


def flown(policy: str, episodes: int, out: Path, most: str | None = None) -> Path:
    """The tables of a shipped policy, flown in a process of its own, with `most` instructions."""
    flags = os.environ.get("XLA_FLAGS", "") + (f" --xla_cpu_max_isa={most}" if most else "")
    words = ["evaluate", policy, "--episodes", str(episodes), "--out", str(out)]
    environment = os.environ | {"XLA_FLAGS": flags, "SKYSTACK_CACHE": "off"}
    command = [sys.executable, "-m", "skystack", *words]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    (tables,) = out.glob(f"{policy}-s*")
    return tables


def likeness(ours: Path, theirs: Path) -> Likeness:
    """Compare the tables of two evaluations."""
    episodes, said = (
        [pq.read_table(folder / f"{name}.parquet") for folder in (ours, theirs)]
        for name in ("episodes", "clearances")
    )
    numbers = episodes[0]["scenario"].to_pylist()
    same = np.array(same_clearances(said[0], said[1], numbers, cycles=0))
    for field in episodes[0].schema:
        if not pa.types.is_floating(field.type):
            first, second = (table[field.name].to_numpy() for table in episodes)
            same &= first == second
    kept = np.array(numbers)[same]
    first, second = (_positions_nm(folder, kept) for folder in (ours, theirs))
    apart_nm = float(np.max(np.hypot(*(first - second)), initial=0.0))
    return Likeness(int(same.sum()), len(same), apart_nm)


def _positions_nm(folder: Path, scenarios: np.ndarray) -> np.ndarray:
    """North and east: a minute of arc is a mile, as the sector lies at the equator."""
    table = pq.read_table(folder / "trajectories.parquet", columns=["scenario", "lat", "lon"])
    kept = np.isin(table["scenario"].to_numpy(), scenarios)
    return np.array([table[name].to_numpy()[kept] * 60.0 for name in ("lat", "lon")])


def off_the_record(policy: str, tables: Path) -> list[str]:
    """Which numbers of all its recorded scenarios are not those recorded beside the policy."""
    measured = read_measured(SHIPPED / policy)
    if measured is None:
        return ["no record"]
    episodes = pq.read_table(tables / "episodes.parquet")
    row, recorded = summarise(policy, 0, "", True, True, 0.0, episodes), measured.stacked
    allowed = {name: part * recorded[name] for name, part in MEANS.items()}
    allowed |= dict.fromkeys(RATES, 1.0 - LEAST_SAME)
    return [
        f"{name} is {row[name]:.6g}, recorded {recorded[name]:.6g}"
        for name, most in allowed.items()
        if abs(row[name] - recorded[name]) > most
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 all as promised, 1 something was not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("policies", nargs="*", metavar="POLICY")
    parser.add_argument("--episodes", type=int, default=1000)
    options = parser.parse_args(arguments)
    holds = True
    sys.stdout.write(
        "| policy | processor | the same | of | apart, NM |\n|---|---|---:|---:|---:|\n"
    )
    for policy in options.policies or shipped_policies():
        with tempfile.TemporaryDirectory(prefix="processors-") as folder:
            here = flown(policy, options.episodes, Path(folder, "here"))
            for name, most in PROCESSORS.items():
                found = likeness(here, flown(policy, options.episodes, Path(folder, name), most))
                cells = (policy, name, found.same, found.scenarios, f"{found.apart_nm:.4f}")
                sys.stdout.write(f"| {' | '.join(map(str, cells))} |\n")
                sys.stdout.flush()
                holds &= found.holds(policy)
            if options.episodes == 1000:
                for line in off_the_record(policy, here):
                    sys.stdout.write(f"{policy}: {line}\n")
                    holds = False
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
