"""The command line: `skystack <verb>`. Thin: parses, calls, prints.

Results go to standard output, progress and prose to standard error. Exit code 0: done; 1: failed
while running; 2: wrong usage or input, told in one line. Heavy imports wait until they are needed.
"""

import signal
import sys
import threading
from collections.abc import Sequence

from skystack.cli.arguments import parse
from skystack.cli.shown import FAILED, INTERRUPTED, PIPE_CLOSED, WRONG, complain
from skystack.errors import InputError, PlatformError, TrainingError
from skystack.streams import ClosedPipeError, Prose, Results, escaping


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    # Terminated like interrupted: workers are stopped and checkpoints written on the way out.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    with escaping():
        try:
            return _main(list(sys.argv[1:] if arguments is None else arguments))
        except InputError as error:
            return complain(str(error), WRONG)
        except (TrainingError, PlatformError) as error:
            return complain(str(error), FAILED)
        except ClosedPipeError:
            return PIPE_CLOSED
        except OSError as error:  # asking for a file can fail before it is read: a name too long
            if error.filename is None:
                raise
            return complain(str(InputError(f"{error.filename}: {error.strerror}")), WRONG)
        except KeyboardInterrupt:
            return complain("interrupted", INTERRUPTED)
        finally:
            Prose().flush()


def _main(arguments: list[str]) -> int:
    """What the verb does and prints, to the last byte."""
    try:
        options = parse(arguments)
        code: int = options.run(options)
    except SystemExit:  # of --help and --version
        Results().flush()
        raise
    Results().flush()
    return code
