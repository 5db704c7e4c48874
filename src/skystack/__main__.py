"""`python -m skystack` is `skystack`."""

import atexit
import os
import sys
from typing import NoReturn

from skystack.cli import main
from skystack.io import signals
from skystack.io.streams import StandardError, open_standard_files


def run() -> NoReturn:
    """The command in a process of its own."""
    with signals.ended_by_signals(last=True):
        open_standard_files()
        code = main()
    ended = signals.exit_code()
    if ended is None:
        sys.exit(code)
    # Threads may still be compiling or flying: at exit Python would wait for them, or crash.
    atexit._run_exitfuncs()
    StandardError().flush()
    os._exit(ended)


if __name__ == "__main__":
    run()
