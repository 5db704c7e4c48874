"""`python -m skystack` is `skystack`."""

import sys
from typing import NoReturn

from skystack.cli import main
from skystack.streams import open_standard_files


def run() -> NoReturn:
    """The command in a process of its own."""
    open_standard_files()
    sys.exit(main())


if __name__ == "__main__":
    run()
