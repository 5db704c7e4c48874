"""Mutated inputs tried in a process of their own; one that ends or hangs is a finding.

Imports nothing of skystack: what steers inputs by the code that they reach must see it imported.
"""

import multiprocessing
import os
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

from verification.inputs.shares import Share, Tally, kept

DEAD_S = 600.0
"""A process that has not come further for so long is ended."""
BEGUN_S = 3600.0
"""The same before its first input: programs are compiled, code is instrumented."""


def try_apart(share: Share, on_input: Callable[[int], None]) -> Tally:
    """Try a share of inputs; after one at which the process ended, another one goes on."""
    total = Tally()
    while share.first < share.end and total.wall_s < share.seconds:
        with TemporaryDirectory(prefix="mutated-", ignore_cleanup_errors=True) as name:
            folder = Path(name) / "tried"  # what guides them lies beside it
            folder.mkdir()
            rest = replace(share, seconds=share.seconds - total.wall_s)
            number, tally, exitcode = _try_until_it_ends(rest, folder, on_input)
            total.add(tally)
            if number is None:
                break
            total.findings[number] = f"the process hung or ended ({exitcode})"
            kept(share, number, folder)
        share = replace(share, first=number + 1)
    return total


def _try_until_it_ends(
    share: Share, folder: Path, on_input: Callable[[int], None]
) -> tuple[int | None, Tally, int | None]:
    """The number at which it did not come further (None: all are done), what came of the others."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_begin, args=(share, folder, theirs))
    process.start()
    theirs.close()
    number: int | None = share.first
    tally, patience_s = Tally(), BEGUN_S
    try:
        while number is not None and ours.poll(patience_s):
            number, tally = ours.recv()
            patience_s = DEAD_S
            if number is not None:
                on_input(number)
    except EOFError:
        pass
    if number is not None:
        process.kill()
    process.join()
    return number, tally, process.exitcode


def _begin(share: Share, folder: Path, parent: Connection) -> None:
    if not share.guided:
        from verification.inputs import trials  # noqa: PLC0415
    else:
        import atheris  # noqa: PLC0415

        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # it says much
        with atheris.instrument_imports(include=["skystack", "tomllib"]):
            from verification.inputs import trials  # noqa: PLC0415
    trials.work(share, folder, parent)
