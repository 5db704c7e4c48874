"""`python -m skystack` is `skystack`."""

import sys

from skystack.cli import main

if __name__ == "__main__":
    sys.exit(main())
