"""What every verb says in the same way."""

import json
import sys
from typing import Any

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


def complain(message: str, code: int) -> int:
    """One line on standard error; returns the exit code."""
    sys.stderr.write(f"skystack: {message}\n")
    return code


def say(line: str) -> None:
    """A line of prose on standard error, as it is: names and paths may hold anything."""
    sys.stderr.write(f"{line}\n")


def print_line(line: str) -> None:
    """A line of results on standard output, as it is."""
    sys.stdout.write(f"{line}\n")


def print_json(value: Any) -> None:
    """One object on standard output."""
    sys.stdout.write(json.dumps(value, indent=1) + "\n")
