"""Errors with one-line messages: user mistakes (exit code 2) and failures (exit code 1)."""

import difflib
import operator
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LONGEST_LINE = 2000
"""The maximum length of a message in characters: untrusted files may hold names of any length."""


class InputError(ValueError):
    """Bad input from the user. One line states what is wrong, where, and what is allowed.

    Unprintable characters are escaped, and a message that is too long is truncated.

    Example:

        >>> import skystack
        >>> try:
        ...     skystack.find_sector("x-pluss")
        ... except skystack.InputError as error:
        ...     print(error)
        unknown sector 'x-pluss'; did you mean 'x-plus'? (allowed: ...)
    """

    def __init__(self, message: str | Exception) -> None:
        text = str(message)  # Gymnasium's workers pass the exception itself as the message
        if len(text) > LONGEST_LINE:
            text = f"{text[:LONGEST_LINE]}..."
        super().__init__(printable(text))


@contextmanager
def error_context(where: str, separator: str = ": ") -> Iterator[None]:
    """Prefix the message of an InputError raised inside the context with its location.

    With the separator ".", `where` becomes part of the path of the field that the message names.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}{separator}{error}") from None


def printable(text: str) -> str:
    """The text with unprintable and control characters escaped."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


MAX_INT = 2**31 - 1
"""The largest seed or count. JAX keeps 32 bits of a seed; larger seeds would repeat scenarios."""


def checked_integer(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Convert an integer of any library to int.

    Raises InputError for other types and for values out of range. True and False are refused,
    although Python treats them as integers.
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


MAX_SUGGESTED_CHARS, MAX_CANDIDATES = 200, 2000
"""Limits for suggesting a similar name: its length, and the number of candidates."""


class CheckpointError(InputError):
    """An earlier training cannot be resumed; its files are unchanged."""


class TrainingError(RuntimeError):
    """Training cannot continue (e.g. a loss is not finite). The message says where; exit code 1."""


class PlatformError(RuntimeError):
    """Another simulator died, hung or lost an aircraft. The message says where; exit code 1."""


def unknown_name(
    kind: str, name: str, allowed: Iterable[str], paths: Iterable[str] = (), also: str = ""
) -> InputError:
    """The error for a name that does not exist; it suggests the most similar one that does.

    `also` states what is allowed in addition to the names. `paths` are as in `suggestion`.
    """
    names = sorted(allowed, key=_in_order)
    hint, listed = suggestion(name, names, paths), also + ", ".join(names) or "none"
    return InputError(f"unknown {kind} {name!r}{hint} (allowed: {listed})")


def _in_order(name: str) -> list[tuple[str, int]]:
    """A key that sorts AC2 before AC10."""
    parts = re.findall(r"(\D*)(\d*)", name)
    return [(text, int(number[:20] or -1)) for text, number in parts]


def suggestion(name: str, allowed: Collection[str], paths: Iterable[str] = ()) -> str:
    """`; did you mean 'NAME'?` with the most similar name, or nothing if none is similar.

    `paths` are files or folders that may have been meant: one that exists is suggested first. If
    exactly one allowed name starts with `name`, it is next.
    """
    near = [path for path in paths if exists(path)]
    if len(begun := [each for each in allowed if name and each.startswith(name)]) == 1:
        near += begun
    if (
        len(name) <= MAX_SUGGESTED_CHARS and len(allowed) <= MAX_CANDIDATES
    ):  # otherwise this takes minutes
        near += difflib.get_close_matches(name, allowed, n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def check_known(kind: str, names: Iterable[str], allowed: Collection[str]) -> None:
    """Raise InputError for the first name that does not exist."""
    for name in names:
        if name not in allowed:
            raise unknown_name(kind, name, allowed)


def exists(path: str | Path) -> bool:
    """Whether a file or folder exists; False if the name is too long."""
    try:
        return Path(path).exists()
    except OSError:
        return False


class MissingExtraError(InputError, ImportError):
    """Packages of an extra are missing. Also an ImportError, as Python expects from an import."""


def missing_extra(feature: str, needs: str, extra: str) -> MissingExtraError:
    """The error for a feature whose packages are not installed; it names the extra to install."""
    verb = "are" if " and " in needs else "is"
    error = MissingExtraError(
        f"{feature} needs {needs}, which {verb} not installed "
        f"(install skystack with the extra [{extra}]; in a checkout: pip install -e '.[{extra}]')"
    )
    error.name = needs
    return error


@contextmanager
def requires_extra(feature: str, extra: str) -> Iterator[None]:
    """Import packages of an extra in the context. Raises MissingExtraError if one is missing."""
    try:
        yield
    except (ModuleNotFoundError, MissingExtraError) as error:  # the latter from our own modules
        raise missing_extra(feature, str(error.name), extra) from None
