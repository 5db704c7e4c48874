"""`python -m skystack` runs the command `skystack`."""

import atexit
import os
import sys
from typing import NoReturn

from skystack.cli import main
from skystack.io import signals
from skystack.io.streams import StandardError, open_standard_files


def run() -> NoReturn:
    """Run the command line and exit the process with its exit code."""
    with signals.handle_signals(last=True):
        open_standard_files()
        code = main()
    signal_code = signals.exit_code()
    if signal_code is None:
        sys.exit(code)
    # Threads may still be compiling or simulating: Python would wait for them at exit, or crash.
    atexit._run_exitfuncs()
    StandardError().flush()
    os._exit(signal_code)


if __name__ == "__main__":
    run()
