"""Try mutated inputs in a separate process; a crash or a hang of the process is a finding.

Imports nothing of skystack, so that the fuzzer can instrument skystack's import.
"""

import multiprocessing
import os
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

from verification.inputs.shares import Share, Tally, keep_files

DEAD_S = 600.0
"""A process without progress for this time is killed."""
START_S = 3600.0
"""The same limit before the first input: programs are compiled and code is instrumented."""


def try_in_process(share: Share, on_input: Callable[[int], None]) -> Tally:
    """Try a share of inputs; if the process dies or hangs, a new one continues after that input."""
    total = Tally()
    while share.first < share.end and total.wall_s < share.seconds:
        with TemporaryDirectory(prefix="mutated-", ignore_cleanup_errors=True) as name:
            folder = Path(name) / "tried"  # the fuzzer's corpus is next to it
            folder.mkdir()
            rest = replace(share, seconds=share.seconds - total.wall_s)
            number, tally, exitcode = _try_until_it_ends(rest, folder, on_input)
            total.add(tally)
            if number is None:
                break
            total.findings[number] = f"the process hung or ended ({exitcode})"
            keep_files(share, number, folder)
        share = replace(share, first=number + 1)
    return total


def _try_until_it_ends(
    share: Share, folder: Path, on_input: Callable[[int], None]
) -> tuple[int | None, Tally, int | None]:
    """The input at which the process stopped (None: all are done), and the tally of the others."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_begin, args=(share, folder, theirs))
    process.start()
    theirs.close()
    number: int | None = share.first
    tally, patience_s = Tally(), START_S
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

        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # Atheris prints a lot
        with atheris.instrument_imports(include=["skystack", "tomllib"]):
            from verification.inputs import trials  # noqa: PLC0415
    trials.work(share, folder, parent)
