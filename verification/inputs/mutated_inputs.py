"""Mutate valid files in many ways: each must be read, or refused with one clear line.

    python -m verification.inputs.mutated_inputs [--format NAME|all] [--count N] [--seed S]
        [--seconds LIMIT] [--guided] [--keep DIR]

Input i of a format depends only on the seed and i; with `--guided` (extra `fuzzing`) also on the
lines of skystack that earlier inputs reached. Every outcome except a result without NaN and a
one-line refusal is a finding: another exception, a warning, more than 10 s (50 s if guided), more
than 1 GB of memory, or the death of the process. Findings are printed, and their files are kept
under DIR. Prints a table; exit code 1 if there are findings.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from verification.inputs.isolation import try_in_process
from verification.inputs.shares import Share


def _options(arguments: Sequence[str] | None, formats: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--format", choices=[*formats, "all"], default="all")
    parser.add_argument("--count", type=int, default=1000, help="inputs per format (default 1,000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9, help="time limit per format")
    parser.add_argument("--guided", action="store_true", help="let a fuzzer choose the inputs")
    parser.add_argument("--keep", type=Path, help="folder for the files of findings")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 no findings, 1 findings."""
    from verification.inputs.untrusted_files import FORMATS  # noqa: PLC0415  (see isolation.py)

    options, console = _options(arguments, list(FORMATS)), Console(stderr=True)
    names = list(FORMATS) if options.format == "all" else [options.format]
    table = Table("format", "inputs", "read", "refused", "findings", "inputs per second")
    found = 0
    for name in names:
        share = Share(
            name,
            first=0,
            end=options.count,
            seed=options.seed,
            seconds=options.seconds,
            guided=options.guided,
            keep=options.keep,
        )
        with Progress(console=console) as bars:
            bar = bars.add_task(name, total=options.count)
            tally = try_in_process(
                share,
                lambda done, bar=bar, bars=bars: bars.update(bar, completed=done),  # type: ignore[misc]
            )
        counts = (tally.inputs, tally.read, tally.refused, len(tally.findings))
        rate = tally.inputs / max(tally.wall_s, 1e-9)
        table.add_row(name, *(f"{count:,}" for count in counts), f"{rate:,.0f}")
        found += len(tally.findings)
        for number, what in tally.findings.items():
            console.print(f"{name} {number}: {what}", markup=False, highlight=False)
    Console(width=100).print(table)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
