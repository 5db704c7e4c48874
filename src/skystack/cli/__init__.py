"""The command line: `skystack VERB`. It only parses, calls and prints.

Results go to standard output, progress and messages to standard error. Exit codes: 0 success; 1
failure while running; 2 invalid usage or input, with one line of explanation. Heavy imports are
delayed until they are needed.
"""

import sys
from collections.abc import Sequence

from skystack.cli.arguments import parse
from skystack.cli.output import FAILED, INTERRUPTED, PIPE_CLOSED, TERMINATED, WRONG, report_error
from skystack.errors import InputError, PlatformError, TrainingError
from skystack.io import signals
from skystack.io.signals import handle_signals
from skystack.io.streams import ClosedPipeError, StandardError, StandardOutput, escaping


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    with handle_signals():
        message = "interrupted"
        try:
            code = _main(list(sys.argv[1:] if arguments is None else arguments))
            signals.record_only()
        except KeyboardInterrupt as interruption:
            signals.record_only()
            code, message = INTERRUPTED, str(interruption) or message
        except BaseException:
            signals.record_only()
            if signals.exit_code() is None:
                raise
            code = INTERRUPTED  # the interruption surfaced as another exception
        ended = signals.exit_code() or code
        return report_error(message, ended) if ended in (INTERRUPTED, TERMINATED) else ended


def _main(arguments: list[str]) -> int:
    with escaping():
        try:
            return _run(arguments)
        except InputError as error:
            return report_error(str(error), WRONG)
        except (TrainingError, PlatformError) as error:
            return report_error(str(error), FAILED)
        except ClosedPipeError:
            return PIPE_CLOSED
        except (
            OSError
        ) as error:  # raised before a file is read, such as for a name that is too long
            if error.filename is None:
                raise
            return report_error(str(InputError(f"{error.filename}: {error.strerror}")), WRONG)
        finally:
            StandardError().flush()


def _run(arguments: list[str]) -> int:
    """Run the verb and flush all its output."""
    try:
        options = parse(arguments)
        code: int = options.run(options)
    except SystemExit:  # from --help and --version
        StandardOutput().flush()
        raise
    StandardOutput().flush()
    return code
