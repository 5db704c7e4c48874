"""Convert plain values to typed ones; an error names the first wrong value and what is allowed.

msgspec converts and checks the values. If it refuses them, the place is found by converting one
part after another, and what is allowed is read from the type. No msgspec message is parsed.
"""

import json
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import msgspec
from msgspec import inspect

from skystack.errors import InputError, unknown_name

MAX_VALUE_CHARS = 60
"""The maximum length of a value in a message, in characters."""


def convert(raw: Any, kind: Any) -> Any:
    """Convert plain values to any type that msgspec supports.

    Raises InputError that names the first wrong value, or an unknown or missing field.
    """
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError:
        raise _error(raw, kind, "") from None


def not_allowed(where: str, value: object, allowed: str) -> InputError:
    """The error for a value that is not allowed; long values are truncated."""
    text = json.dumps(value)
    text = text if len(text) <= MAX_VALUE_CHARS else f"{text[:MAX_VALUE_CHARS]}..."
    return InputError(f"{where} is {text} (allowed: {allowed})")


def _error(value: Any, kind: Any, where: str) -> InputError:
    """The error for a value of the wrong type: for its first wrong part, or for itself."""
    if _is_struct(inner := _without_metadata(_member(kind, value))) and isinstance(value, dict):
        return _struct_error(value, inner, where)
    for step, part, part_kind in _parts(value, inner):
        if not _fits(part, part_kind):
            return _error(part, part_kind, f"{where}{step}")
    return not_allowed(where or "the file", value, allowed_words(kind))


def _struct_error(value: dict[str, Any], kind: Any, where: str) -> InputError:
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}
    for name in value:
        if name not in fields and kind.__struct_config__.forbid_unknown_fields:
            unknown = unknown_name("field", str(name), fields)
            return InputError(f"{where}: {unknown}" if where else str(unknown))
    for name, field in fields.items():
        inner = f"{where}.{name}" if where else name
        if name not in value:
            if field.required:
                return InputError(f"{inner} is missing")
        elif not _fits(value[name], field.type):
            return _error(value[name], field.type, inner)
    return not_allowed(where or "the file", value, allowed_words(kind))


def _parts(value: Any, kind: Any) -> Iterator[tuple[str, Any, Any]]:
    """The parts of a list or an object: the path, the value and the type of each."""
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(value, dict) and origin is dict:
        for name, each in value.items():
            yield f".{name}", each, arguments[1]
    if isinstance(value, list) and origin in (list, tuple):
        uniform = origin is list or arguments[-1] is Ellipsis
        kinds = [arguments[0]] * len(value) if uniform else list(arguments)
        for index, (each, each_kind) in enumerate(zip(value, kinds, strict=False)):
            yield f"[{index}]", each, each_kind


def _fits(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _member(kind: Any, value: Any) -> Any:
    """The member of a union with the value's form (object or list), or else the whole union."""
    inner = _without_metadata(kind)
    if get_origin(inner) not in (Union, UnionType):
        return kind
    members = [each for each in get_args(inner) if each is not NoneType]
    fitting = [each for each in members if _form(_without_metadata(each)) is type(value)]
    return fitting[0] if len(fitting) == 1 else kind


def _form(kind: Any) -> type | None:
    if _is_struct(kind) or get_origin(kind) is dict:
        return dict
    return list if get_origin(kind) in (list, tuple) else None


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _without_metadata(kind: Any) -> Any:
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def allowed_words(kind: Any) -> str:
    """What a type allows, in words."""
    return _words(inspect.type_info(kind))


def _words(kind: inspect.Type) -> str:
    if isinstance(kind, inspect.Metadata):
        described = (kind.extra_json_schema or {}).get("description")
        return str(described or _words(kind.type))
    if isinstance(kind, inspect.UnionType):
        members = (each for each in kind.types if not isinstance(each, inspect.NoneType))
        return " or ".join(map(_words, members))
    if isinstance(kind, inspect.IntType | inspect.FloatType):
        name = "whole number" if isinstance(kind, inspect.IntType) else "number"
        multiple = f", a multiple of {_number(kind.multiple_of)}" if kind.multiple_of else ""
        return f"{name}{_range(kind.ge, kind.gt, kind.le)}{multiple}"
    if isinstance(kind, inspect.LiteralType):
        return ", ".join(map(str, kind.values))
    return _form_words(kind)


def _form_words(kind: inspect.Type) -> str:
    match kind:
        case inspect.BoolType():
            words = "true or false"
        case inspect.StrType():
            words = f"text{_length(kind.min_length, kind.max_length, ' characters')}"
        case inspect.TupleType():
            words = f"list of {len(kind.item_types)}"
        case inspect.ListType() | inspect.VarTupleType():
            words = f"list{_length(kind.min_length, kind.max_length, '')}"
        case _:
            words = "object"
    return words


def _range(least: float | None, above: float | None, most: float | None) -> str:
    if above is not None:
        return f" above {_number(above)}" + (f", up to {_number(most)}" if most is not None else "")
    begin = f" from {_number(least)}" if least is not None else ""
    return begin + (f" to {_number(most)}" if most is not None else "")


def _number(value: float) -> str:
    """A number as text; whole numbers with separators: 1,000,000."""
    return f"{int(value):,}" if value == int(value) else f"{value:g}"


def _length(least: int | None, most: int | None, what: str) -> str:
    if least is not None and most is not None:
        return f" of {_number(least)} to {_number(most)}{what}"
    if least is not None:
        return f" of at least {_number(least)}{what}"
    return f" of at most {_number(most)}{what}" if most is not None else ""
