"""The verb `session`: control live traffic on a radar page, or by typing clearances."""

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from skystack.cli.output import DONE, print_json, print_line, program, quoted, say
from skystack.cli.values import cycles_argument, natural, platform_argument
from skystack.errors import InputError
from skystack.io.streams import StandardError

PORT = 8765
LONGEST_LINE = 1000
"""Longer lines of input are split."""


def session_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "traffic",
        nargs="?",
        default="60",
        metavar="TRAFFIC",
        help="flights per hour (default 60); category (or flight-school), notebook or environment; "
        "springfield:SCENARIO; an experiment (name or .toml); or a scenario file (.json)",
    )
    sub.add_argument("--seed", type=natural, default=0, metavar="N", help="seed of the traffic")
    sub.add_argument(
        "--sector",
        metavar="SECTOR",
        help="a name or a sector file (default: the adviser's, or x-plus)",
    )
    sub.add_argument(
        "--adviser",
        metavar="AGENT",
        help="who gives advice and takes over flights: search, sector-control or another "
        "controller of a sector",
    )
    cycles_argument(sub, "600, an hour; for a scenario, its length", None)
    platform_argument(sub)
    sub.add_argument(
        "--out",
        type=Path,
        default=Path("runs/session"),
        metavar="DIR",
        help="folder for recordings (default runs/session)",
    )
    sub.add_argument(
        "--new",
        action="store_true",
        help="begin another session; the journal of an earlier one is replaced",
    )
    sub.add_argument(
        "--port", type=natural, default=PORT, metavar="N", help=f"default {PORT}; 0: any free port"
    )
    sub.add_argument(
        "--listen",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to listen on (default: only this computer); with another one, everybody on "
        "the network who has the link can control the session, without encryption",
    )
    sub.add_argument(
        "--text", action="store_true", help="a dialogue in the terminal instead of a radar page"
    )


def session(options: argparse.Namespace) -> int:
    from skystack.compilation.programs import program_cache
    from skystack.evaluation.traffic_conditions import TrafficConditions, cycles_of, traffic_name
    from skystack.live.recorded import open_session

    traffic = traffic_name(options.traffic)
    conditions = TrafficConditions(
        traffic,
        seed=options.seed,
        sector=options.sector,
        cycles=cycles_of(traffic, options.cycles),
        platform=options.platform,
    )
    hangs = False
    with program_cache():
        opened = open_session(conditions, options.adviser)
        for note in opened.notes:
            say(note)
        with closing(opened.hour):
            if options.text:
                _in_text(opened, options)
            else:
                hangs = _on_page(opened, options)
    if hangs:
        sys.stdout.flush()
        os._exit(DONE)  # a thread that hangs would be waited for
    return DONE


def _on_page(opened: Any, options: argparse.Namespace) -> bool:
    """Serve the radar page until Ctrl-C, and write the recording.

    Returns whether the thread of the session hangs.
    """
    from skystack.live.serving import Serving, serve

    serving = Serving(options.out, options.listen, options.port, options.new)
    control, hangs = serve(opened, serving, options.adviser, say)
    if control.cycle:
        folder = _write(opened, options)
        if len(control.log):
            control.log.write(folder)
        for branch in control.branches:
            both = f"{quoted(folder)} {quoted(branch)}"
            say(f"to compare with what you left: {program()} replay {both} -o comparison.html")
    return hangs


def _in_text(opened: Any, options: argparse.Namespace) -> None:
    """Hold the dialogue, and write the recording."""
    from skystack.io.files import make_folder
    from skystack.live.text_session import TextSession

    make_folder(options.out)  # fail now if the recording cannot be written
    say("`help` lists what can be typed; an empty line flies a cycle")
    try:
        _converse(TextSession(opened.hour, opened.adviser, opened.conditions.cycles), options.json)
    finally:
        if opened.hour.cycle:
            _write(opened, options)


def _write(opened: Any, options: argparse.Namespace) -> Path:
    """Write the recording; returns its folder."""
    folder: Path
    folder, row = opened.write(options.out)
    if options.json:
        print_json(row)
    say(f"written: {folder}")
    say(f"to see the flights: {program()} replay {quoted(folder)} -o replay.html")
    return folder


def _converse(session: Any, json: bool) -> None:
    """Answer the lines of standard input until the session ends.

    With `json`, answers go to standard error.
    """
    for line in _lines():
        try:
            answer = session.answer(line)
        except InputError as error:
            say(f"refused: {error}")
            continue
        for each in answer:
            (say if json else print_line)(each)
        sys.stdout.flush()
        if session.ended:
            return


def _lines() -> Iterator[str]:
    """The lines of standard input, with a prompt in a terminal."""
    if sys.stdin is None:
        return
    is_terminal = sys.stdin.isatty()
    while True:
        if is_terminal:
            StandardError().write("> ")
        line = sys.stdin.buffer.readline(LONGEST_LINE)
        if not line:
            return
        yield line.decode(errors="replace")
