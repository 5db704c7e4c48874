"""What every verb prints in the same way, in lines; tables and progress: `skystack.cli.console`."""

import json
from typing import Any

from skystack.errors import printable
from skystack.io.streams import StandardError, StandardOutput

DONE, FAILED, WRONG, INTERRUPTED, PIPE_CLOSED, TERMINATED = 0, 1, 2, 130, 141, 143
"""Exit codes. The last three are the shell's codes for SIGINT, SIGPIPE and SIGTERM."""


def complain(message: str, code: int) -> int:
    """One line on standard error; returns the exit code."""
    say(f"skystack: {message}")
    return code


def say(line: str) -> None:
    """A line of prose on standard error; names and paths may hold anything."""
    StandardError().write(f"{printable(line)}\n")


def print_line(line: str) -> None:
    """A line of results on standard output."""
    StandardOutput().write(f"{printable(line)}\n")


def print_json(value: Any) -> None:
    """One object on standard output, in ASCII."""
    StandardOutput().write(json.dumps(value, indent=1) + "\n")
