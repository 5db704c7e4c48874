"""JSON from strangers, read strictly: one line says which field is wrong and what is allowed."""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn, get_args, get_type_hints

import msgspec

from skystack.errors import InputError, error_context, unknown_name
from skystack.io.files import read_whole
from skystack.io.names import in_words

MAX_BYTES = 10_000_000
MAX_DEPTH = 32
_TOO_DEEP = f"is nested too deep (allowed: {MAX_DEPTH} levels)"
MAX_NUMBER = sys.float_info.max
MOST_EXACT = 2.0**53
"""Up to here a double holds every whole number."""

Entries = Mapping[str, type[msgspec.Struct]]
"""The structures of a file by where they stand: "" is the whole, "aircraft" the members of a list
(or the one that stands there), "fixes.*" those of an object with names of the file's own."""


def read_json(path: Path) -> Any:
    """The plain values of a file: UTF-8, finite numbers, no field twice in an object.

    Raises InputError for a file that cannot be read, is too large or is not such JSON.
    """
    data = read_whole(path, MAX_BYTES)
    if not data.strip():
        raise InputError("is empty (allowed: JSON)")
    try:
        raw = json.loads(
            data.decode("utf-8-sig"),
            object_pairs_hook=_object,
            parse_constant=_refuse_constant,
        )
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 (byte {error.start})") from None
    except InputError:
        raise
    except json.JSONDecodeError as error:
        raise InputError(f"is not JSON ({error})") from None
    except (ValueError, RecursionError) as error:
        raise beyond_python(error) from None
    check_plain(raw)
    return with_whole_numbers(raw)


def with_whole_numbers(value: Any) -> Any:
    """The same values, whole numbers as such: 220.0 is a way to write 220 in JSON and in TOML."""
    if isinstance(value, dict):
        return {key: with_whole_numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return [with_whole_numbers(each) for each in value]
    whole = isinstance(value, float) and value.is_integer() and abs(value) <= MOST_EXACT
    return int(value) if whole else value


def check_plain(value: Any, where: str = "", depth: int = 0) -> None:
    """Check values that a parser lets through and what follows would not bear.

    Raises InputError that names the place of numbers that are not finite, text that is no Unicode,
    dates, and lists and objects that are nested too deep.
    """
    if isinstance(value, dict | list):
        if depth == MAX_DEPTH:
            raise InputError(f"{where} {_TOO_DEEP}")
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        for key, each in inner:
            step = f".{key}" if isinstance(value, dict) else f"[{key}]"
            check_plain(each, f"{where}{step}".removeprefix("."), depth + 1)
    elif isinstance(value, str):
        if any("\ud800" <= each <= "\udfff" for each in value):
            raise not_allowed(where, value, "printable characters")
    elif isinstance(value, int | float):
        if not -MAX_NUMBER <= value <= MAX_NUMBER:  # true of NaN, too
            raise not_allowed(where, value, "finite number")
    elif value is not None:
        raise InputError(f"{where} is {value} (allowed: no dates or times)")


def beyond_python(error: ValueError | RecursionError) -> InputError:
    """The error for nesting too deep, or a number too long, for Python's parsers."""
    if isinstance(error, RecursionError):
        return InputError(_TOO_DEEP)
    return InputError("has a whole number with too many digits (allowed: 4300)")


def decode(data: bytes, kind: Any, where: str) -> Any:
    """JSON of a known shape. Raises InputError that says where it is damaged."""
    try:
        plain = msgspec.json.decode(data)
        try:
            return msgspec.convert(plain, kind)
        except msgspec.ValidationError:  # only then: what may be any number stays as written
            return msgspec.convert(with_whole_numbers(plain), kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{where}: damaged: {in_words(str(error))}") from None


def convert(raw: Any, entries: Entries) -> Any:
    """Plain values as the structure `entries[""]`. Raises InputError that names the field."""
    _check_names(raw, entries)
    for place, entry in entries.items():
        table = raw.get(place.removesuffix(".*")) if isinstance(raw, dict) else None
        if place.endswith(".*") and isinstance(table, dict):
            for name, value in table.items():  # msgspec would say [...] in place of the name
                with error_context(f"{place[:-2]}.{name}"):
                    convert(value, {"": entry})
    try:
        return msgspec.convert(raw, entries[""])
    except msgspec.ValidationError as error:
        raise _refusal(in_words(str(error)), raw, entries) from None


def is_name(text: str) -> bool:
    """Whether a text can name something: printable, not empty, no blank at either end."""
    return bool(text) and text.isprintable() and text == text.strip()


def not_allowed(where: str, value: object, allowed: str) -> InputError:
    """The error for a value, shown as JSON and cut where it is long."""
    shown = json.dumps(value)
    shown = shown if len(shown) <= 60 else f"{shown[:60]}..."
    return InputError(f"{where} is {shown} (allowed: {allowed})")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of the file; `json` itself would silently let the last of two fields win."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InputError(f"field {name!r} stands twice in one object (allowed: once)")
        found[name] = value
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise InputError(f"{name} is no number of JSON (allowed: finite numbers)")


def _check_names(raw: Any, entries: Entries) -> None:
    """Refuse names that msgspec could not name in its message, which `_refusal` reads."""
    if isinstance(raw, dict):
        for name, value in raw.items():
            if not name.isprintable() or "`" in name:
                fields = {field for entry in entries.values() for field in entry.__struct_fields__}
                raise unknown_name("field", name, fields)
            _check_names(value, entries)
    elif isinstance(raw, list):
        for value in raw:
            _check_names(value, entries)


_REFUSAL = re.compile(r"(?P<what>.*?)(?: - at `\$\.(?P<where>.*)`)?", re.DOTALL)
_JSON_WORDS = {
    "int": "whole number",
    "float": "number",
    "str": "text",
    "bool": "true or false",
    "array": "list",
}


def _refusal(message: str, raw: Any, entries: Entries) -> InputError:
    """What msgspec refused in the words of a JSON file, with the value."""
    found = _REFUSAL.fullmatch(message)
    what, where = (found["what"], found["where"] or "") if found else (message, "")
    if "..." in where:  # in an object with names of the file's own, which msgspec does not give
        return InputError(f"{where}: {what[0].lower()}{what[1:]}")
    value = raw
    for step in re.findall(r"\w+", where):
        value = value[int(step)] if isinstance(value, list | tuple) else value[step]
    if what.startswith("Object contains unknown field"):
        fields = entries[where.partition("[")[0]].__struct_fields__
        unknown = unknown_name("field", next(name for name in value if name not in fields), fields)
        return InputError(f"{where}: {unknown}".removeprefix(": "))
    if what.startswith("Object missing required field"):
        missing = what.split("`")[1]
        return InputError(f"{where}.{missing} is missing".removeprefix("."))
    if what.startswith("Number out of range"):
        return not_allowed(where, value, "finite number")
    if what.startswith("Invalid enum value"):
        table, _, field = where.rpartition(".")
        return not_allowed(where, value, ", ".join(get_args(get_type_hints(entries[table])[field])))
    allowed = what.partition(", got")[0].removeprefix("Expected ")
    allowed = allowed.replace("`", "").replace(" | null", "").replace(" | ", " or ")
    allowed = re.sub(r"\w+", lambda word: _JSON_WORDS.get(word[0], word[0]), allowed)
    return not_allowed(where or "the file", value, allowed)
