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


def print_json(value: Any) -> None:
    """One object on standard output."""
    sys.stdout.write(json.dumps(value, indent=1) + "\n")
