"""What goes wrong in one clear line: a user's mistake (exit code 2), or a failure (1)."""

import difflib
import operator
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LONGEST_LINE = 2000
"""Characters of a message; files from strangers may hold names of any length."""


class InputError(ValueError):
    """Bad input from the user: the message says what, where and what is allowed, in one line.

    What cannot be printed is escaped, and what is too long is cut.
    """

    def __init__(self, message: str | Exception) -> None:
        shown = str(message)  # Gymnasium's workers hand over the error itself as its message
        if len(shown) > LONGEST_LINE:
            shown = f"{shown[:LONGEST_LINE]}..."
        super().__init__(printable(shown))


@contextmanager
def error_context(where: str) -> Iterator[None]:
    """Prefix the message of an InputError raised in the context with where it happened."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def printable(text: str) -> str:
    """The text with unprintable and control characters escaped."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


MOST_NUMBER = 2**31 - 1
"""The greatest seed or count. JAX keeps 32 bits of a seed; greater ones would repeat scenarios."""


def checked_whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """An integer of any library as an int. Raises InputError for other values or out of range.

    True and False are refused, although Python counts them as numbers.
    """
    kind = str(getattr(value, "dtype", type(value).__name__))
    try:
        number = None if kind.endswith("bool") else operator.index(value)
    except TypeError:
        number = None
    if number is None or number < least or (most is not None and number > most):
        allowed = f"from {least}" if most is None else f"from {least} to {most}"
        raise InputError(f"{name} is {value!r} (allowed: whole numbers {allowed})")
    return number


LONGEST_NAME, MOST_NAMES = 200, 2000
"""Among which the nearest name is sought."""


class CheckpointError(InputError):
    """What an earlier training left cannot be gone on with; nothing of it was changed."""


class TrainingError(RuntimeError):
    """Training cannot go on (a loss that is no number): the message names where; exit code 1."""


class PlatformError(RuntimeError):
    """Another simulator died, hung or lost an aircraft: the message names where; exit code 1."""


def unknown_name(
    kind: str, name: str, allowed: Iterable[str], paths: Iterable[str] = ()
) -> InputError:
    """The error for a name that does not exist, with the nearest one that does.

    `paths` are files or folders that may have been meant: one that is there is the nearest.
    """
    names = sorted(allowed)
    near = [path for path in paths if exists(path)]
    if len(name) <= LONGEST_NAME and len(names) <= MOST_NAMES:  # else it takes minutes
        near += difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return InputError(f"unknown {kind} {name!r}{hint} (allowed: {', '.join(names)})")


def exists(path: str | Path) -> bool:
    """Whether a file or folder exists; False if the name is too long."""
    try:
        return Path(path).exists()
    except OSError:
        return False


class MissingExtraError(InputError, ImportError):
    """Packages of an extra are missing; also an ImportError, as Python expects from an import."""


def missing_extra(who: str, needs: str, extra: str) -> MissingExtraError:
    """The error for what needs packages that are not installed, with the extra that has them."""
    error = MissingExtraError(
        f"{who} needs {needs}, not installed here (install skystack with the extra [{extra}])"
    )
    error.name = needs
    return error


@contextmanager
def of_extra(who: str, extra: str) -> Iterator[None]:
    """Import packages of an extra in the context. Raises MissingExtraError if one is missing."""
    try:
        yield
    except (ModuleNotFoundError, MissingExtraError) as error:  # the latter of a module of ours
        raise missing_extra(who, str(error.name), extra) from None
