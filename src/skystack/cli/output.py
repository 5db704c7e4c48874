"""Lines that all verbs print alike; for tables and progress see `skystack.cli.console`."""

import json
import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

from skystack.errors import printable
from skystack.io.streams import StandardError, StandardOutput

DONE, FAILED, WRONG, INTERRUPTED, PIPE_CLOSED, TERMINATED = 0, 1, 2, 130, 141, 143
"""Exit codes. The last three are the shell's codes for SIGINT, SIGPIPE and SIGTERM."""


def report_error(message: str, code: int) -> int:
    """Print an error in one line on standard error; returns the exit code."""
    say(f"skystack: {message}")
    return code


def say(line: str) -> None:
    """Print a message on standard error; unprintable characters are escaped."""
    StandardError().write(f"{printable(line)}\n")


def print_line(line: str) -> None:
    """Print a line of results on standard output; unprintable characters are escaped."""
    StandardOutput().write(f"{printable(line)}\n")


def print_json(value: Any) -> None:
    """Print a JSON object on standard output, in ASCII."""
    StandardOutput().write(json.dumps(value, indent=1) + "\n")


def quoted(path: Path) -> str:
    """The path as a word of a shell command."""
    return shlex.quote(str(path))


def program() -> str:
    """The words that start skystack in this shell."""
    if shutil.which("skystack"):
        return "skystack"
    return f"{shlex.quote(os.path.relpath(sys.executable))} -m skystack"
