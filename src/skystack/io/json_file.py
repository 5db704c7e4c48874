"""JSON: strict reading of untrusted files, and numbers that JSON can express.

A one-line error names the field and what is allowed.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any, NoReturn

import msgspec

from skystack.errors import InputError
from skystack.io.files import read_whole
from skystack.io.validation import convert, not_allowed

MAX_BYTES = 10_000_000
MAX_DEPTH = 32
_TOO_DEEP = f"is nested too deep (allowed: {MAX_DEPTH} levels)"
MAX_NUMBER = sys.float_info.max
MAX_EXACT_INT = 2.0**53
"""A double holds every whole number up to this one exactly."""


def read_json(path: Path) -> Any:
    """The values of a JSON file: UTF-8, finite numbers, no duplicate fields in an object.

    Raises InputError for a file that cannot be read, is too large or is not valid.
    """
    data = read_whole(path, MAX_BYTES)
    if not data.strip():
        raise InputError("is empty (allowed: JSON)")
    try:
        raw = json.loads(
            data.decode("utf-8-sig"),
            object_pairs_hook=_unique_fields,
            parse_constant=_refuse_constant,
        )
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 (byte {error.start})") from None
    except InputError:
        raise
    except json.JSONDecodeError as error:
        raise InputError(f"is not JSON ({error})") from None
    except (ValueError, RecursionError) as error:
        raise parser_limit_error(error) from None
    check_plain(raw)
    return with_whole_numbers(raw)


def finite(value: Any) -> float | None:
    """The number for JSON, which has no infinity and no NaN: None if it is not finite."""
    number = float(value)
    return number if math.isfinite(number) else None


def with_whole_numbers(value: Any) -> Any:
    """The same values with whole floats as integers: JSON and TOML files may write 220 as 220.0."""
    if isinstance(value, dict):
        return {key: with_whole_numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return [with_whole_numbers(each) for each in value]
    whole = isinstance(value, float) and value.is_integer() and abs(value) <= MAX_EXACT_INT
    return int(value) if whole else value


def check_plain(value: Any, where: str = "", depth: int = 0) -> None:
    """Refuse values that parsers accept but the rest of the code cannot handle.

    These are non-finite numbers, text that is not valid Unicode, dates, and lists and objects that
    are nested too deep. Raises InputError that names the place.
    """
    if isinstance(value, dict | list):
        if depth == MAX_DEPTH:
            raise InputError(f"{where} {_TOO_DEEP}")
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        for key, each in inner:
            step = f".{key}" if isinstance(value, dict) else f"[{key}]"
            if isinstance(key, str):
                _check_unicode(f"a field name{f' in {where}' if where else ''}", key)
            check_plain(each, f"{where}{step}".removeprefix("."), depth + 1)
    elif isinstance(value, str):
        _check_unicode(where or "the file", value)
    elif isinstance(value, int | float):
        if not -MAX_NUMBER <= value <= MAX_NUMBER:  # true of NaN too
            raise not_allowed(where or "the file", value, "finite number")
    elif value is not None:
        raise InputError(f"{where} is {value} (allowed: no dates or times)")


def _check_unicode(where: str, text: str) -> None:
    if any("\ud800" <= each <= "\udfff" for each in text):
        raise not_allowed(where, text, "printable characters")


def parser_limit_error(error: ValueError | RecursionError) -> InputError:
    """The error for nesting too deep, or an integer too long, for Python's parsers."""
    if isinstance(error, RecursionError):
        return InputError(_TOO_DEEP)
    return InputError("has a whole number with too many digits (allowed: 4300)")


def decode(data: bytes, kind: Any, where: str) -> Any:
    """Decode JSON to a value of type `kind`. Raises InputError that states where it is damaged."""
    try:
        plain = msgspec.json.decode(data)
        try:
            return msgspec.convert(plain, kind)
        except msgspec.ValidationError:  # a fallback: untyped fields keep 1.0 as written
            return convert(with_whole_numbers(plain), kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, InputError) as error:
        raise InputError(f"{where}: damaged: {error}") from None


def is_name(text: str) -> bool:
    """Whether a text is valid as a name: printable, not empty, no space at either end."""
    return bool(text) and text.isprintable() and text == text.strip()


def _unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object without duplicate fields; `json` itself would silently keep the last one."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InputError(f"field {name!r} appears twice in one object (allowed: once)")
        found[name] = value
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise InputError(f"{name} is not a JSON number (allowed: finite numbers)")
