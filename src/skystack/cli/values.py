"""Values of arguments, and arguments that several verbs have. Errors state what is allowed."""

import argparse

from skystack.errors import MAX_INT
from skystack.simulator.limits import MAX_CYCLES


def platform_argument(sub: argparse.ArgumentParser) -> None:
    """Add `--platform`."""
    sub.add_argument(
        "--platform",
        default="skystack",
        metavar="NAME",
        help="simulator: skystack (default), bluebird or bluesky (extras)",
    )


def cycles_argument(
    sub: argparse.ArgumentParser, default: str = "the experiment's", value: int | None = None
) -> None:
    sub.add_argument(
        "--cycles",
        type=cycle_limit,
        default=value,
        metavar="N",
        help=f"maximum number of radar cycles per scenario (default: {default})",
    )


def _integer(text: str, least: int, most: int = MAX_INT) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if not least <= number <= most:
        limit = f" to {most}" if most < MAX_INT or number > most else ""
        raise argparse.ArgumentTypeError(f"{text!r} (allowed: whole numbers from {least}{limit})")
    return number


def cycle_limit(text: str) -> int:
    return _integer(text, least=1, most=MAX_CYCLES)


def positive(text: str) -> int:
    return _integer(text, least=1)


def natural(text: str) -> int:
    return _integer(text, least=0)
