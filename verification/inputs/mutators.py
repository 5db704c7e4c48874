"""Mutators of bytes, JSON, TOML, Parquet, tensors, ONNX and zip files, given a generator."""

import io
import json
import re
import struct
import warnings
import zipfile
from collections.abc import Iterator
from copy import deepcopy
from random import Random
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

_RAW: tuple[str, ...] = ("1e999", "-1e999", "NaN", "inf", "-inf", "1" * 5000, "1" * 400)
_RAW += ("0x10", "'", "[" * 300)
_RAW += ("[" * 20_000, '{"a":' * 900, "[" * 900 + "]" * 900, "[" * 5000 + "]" * 5000)
_RAW += ("1979-05-27", "07:32:00", "1e-400", "-0.0", "", "\\ud800", '"\\ud800"', "null", "nan")
_MARK = re.compile(r'"@raw:(\d+)"')
"""A placeholder for text that no JSON or TOML writer produces; it is replaced after writing."""
_STRANGE: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 10, 299, 360, 600, 2**31, 2**53, 2**63, 2**64, -(2**63), 10**30),
    *(0.5, -0.5, 1e-320, 1e30, 3.5e38, 1.8e308, -1e308, float("nan"), float("inf"), -float("inf")),
    *("", " ", "a", "NaN", "../../x.json", "/etc/passwd.json", "x.json\0", "a\nb", "\u2028", "`a`"),
    *(
        "\x1b[31m",
        "é" * 50,
        "x" * 5000,
        "\U0001f6e9",
        "\ud800",
        "AC1",
        "x-plus",
        "bluebird:X-Sector",
    ),
    *([], {}, [[]], [None], {"": 0}, {"a\nb": 1}, list(range(300))),
)


PATHS: tuple[str, ...] = (
    *("../x", "../../../x", "..", ".", "", "/", "a/b", "./a", "/abs", "/dev/zero", "~/x"),
    *("a\0b", "\0", "a\\b", "..\\x", "C:\\x", "C:x", "\\\\host\\x", "file:///etc/passwd"),
    *("-rf", ".hidden", "a.", "a ", "CON", "$HOME", "`id`", "$(id)", "%2e%2e/x", "é", "e\u0301"),
    "x" * 5000,
)
"""Names that lead to other folders, or that are invalid on some system."""
FOR_TERMINALS: tuple[str, ...] = (
    *("\x1b[31mred", "\x1b]0;title\x07", "\x1b[2J", "\x9b31m", "\r over", "a\x08b", "a\nb", "\x07"),
    *("[/b]", "[b]", "[link=file:///etc/passwd]x[/link]", "[red]", "[", "]", "[/]", ":bomb:"),
    *("\u202eabc", "\u2066abc", "\u200fabc", "\ufeff", "\u2028", "\u0085", "\x7f", "a\u0300" * 300),
    *("<script>", "</script>", "<!--", "{{ 7*7 }}", "{x}", "%s", "$x^2$", "$\\input{x}$", "&amp;"),
)
"""Texts that a terminal, Rich, a browser, a template engine or Matplotlib would interpret."""
HOSTILE = (*PATHS, *FOR_TERMINALS)
LONG = (10, 100, 1000, 9990)
"""Numbers of names inserted into a route, which then has up to 10,000 fixes."""


def mutated_bytes(random: Random, data: bytes) -> bytes:
    """Bytes with one to four changes: bits flipped; bytes set, deleted, repeated or inserted."""
    changed = bytearray(data)
    for _ in range(random.randint(1, 4)):
        at = random.randrange(len(changed) + 1)
        span = random.choice((1, 2, 4, 8, random.randrange(1, 200)))
        kind = random.randrange(6)
        if kind == 0 and changed:
            changed[at % len(changed)] ^= 1 << random.randrange(8)
        elif kind == 1:
            changed[at : at + 1] = bytes([random.choice((0, 1, 0x7F, 0x80, 0xFF, 0x22, 0x0A))])
        elif kind == 2:
            del changed[at : at + span]
        elif kind == 3:
            changed[at:at] = random.randbytes(span)
        elif kind == 4:
            changed[at:at] = changed[at : at + span] * random.choice((1, 2, 50))
        elif random.random() < 0.3:
            del changed[at:]
        else:
            number = random.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1))
            changed[at : at + 8] = struct.pack("<Q", number)
    return bytes(changed)


def mutated_value(random: Random, value: Any) -> Any:
    """A value with one to three parts changed, deleted, repeated, renamed or exchanged."""
    value = deepcopy(value)
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        value = _changed_once(random, value)
    return value


def _changed_once(random: Random, value: Any) -> Any:  # noqa: C901  (one branch per kind)
    places = _places(value) if isinstance(value, dict | list) else []
    if not places or random.random() < 0.01:
        return deepcopy(random.choice(_STRANGE))
    holder, key = random.choice(places)
    kind = random.randrange(9)
    if kind == 0:
        del holder[key]
    elif kind == 8:
        _lengthened(random, holder, key)
    elif kind == 1 and isinstance(holder, dict):
        name = random.choice(("", "x", "a\nb", f"{key} ", f"{key}s", "a.b", "`", "é", "\ud800"))
        holder[name] = holder[key] if random.random() < 0.5 else holder.pop(key)
    elif kind == 1:
        holder[key:key] = [holder[key]] * random.choice((1, 2, 1000))
    elif kind == 2:
        other, name = random.choice(places)
        holder[key] = deepcopy(other[name])
    elif kind == 3 and isinstance(holder[key], int | float):
        change = random.choice((-1, 1, 10, 0.1, 1e-9, 180, -360, 1e6))
        holder[key] = random.choice((holder[key] + change, holder[key] * change, -holder[key]))
    elif kind == 4 and isinstance(holder[key], str):
        holder[key] = mutated_bytes(random, holder[key].encode("utf-8", "replace")).decode(
            "utf-8", "replace"
        )
    elif kind == 5:
        holder[key] = random.choice(([holder[key]], str(holder[key]), {"x": holder[key]}))
    elif kind == 6:
        holder[key] = f"@raw:{random.randrange(len(_RAW))}"
    else:
        holder[key] = deepcopy(random.choice(_STRANGE))
    return value


def _lengthened(random: Random, holder: Any, key: Any) -> None:
    """Insert a hostile text, or repeat the first fixes of a route many times."""
    value = holder[key]
    is_route = isinstance(value, list) and len(value) > 1 and all(isinstance(x, str) for x in value)
    if is_route:
        value[1:1] = [value[1], value[0]] * (random.choice(LONG) // 2)
    else:
        holder[key] = random.choice(HOSTILE)


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every place in nested lists and objects, as its container and its key."""
    found: list[tuple[Any, Any]] = []
    rest = [value]
    while rest:
        holder = rest.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        found += [(holder, key) for key in keys]
        rest += [holder[key] for key in keys if isinstance(holder[key], dict | list)]
    return found


def mutated_json(random: Random, data: bytes) -> bytes:
    """JSON with mutated values, a duplicate field, or mutated bytes."""
    if random.random() < 0.25:
        return mutated_bytes(random, data)
    text = json.dumps(mutated_value(random, json.loads(data)), ensure_ascii=random.random() < 0.8)
    text = _MARK.sub(lambda found: _RAW[int(found[1]) % len(_RAW)], text)
    if random.random() < 0.05:
        text = re.sub(r'("\w+": )', r"\1 1, \1", text, count=1)
    return text.encode("utf-8", "surrogatepass")


def mutated_json_lines(random: Random, data: bytes) -> bytes:
    """JSON lines with one line mutated, or with mutated bytes."""
    lines = data.splitlines(keepends=True)
    at = random.randrange(len(lines))
    if random.random() < 0.2:
        return mutated_bytes(random, data)
    lines[at] = mutated_json(random, lines[at]) + b"\n"
    return b"".join(lines)


def mutated_toml(random: Random, values: bytes, loads: Any) -> bytes:
    """TOML with mutated values, as far as TOML can express them, or with mutated bytes."""
    if random.random() < 0.3:
        return mutated_bytes(random, values)
    try:
        text = tomli_w.dumps(_without_null(mutated_value(random, loads(values.decode()))))
    except (TypeError, AttributeError):  # it is no longer a table
        return mutated_bytes(random, values)
    text = _MARK.sub(lambda found: _RAW[int(found[1]) % len(_RAW)], text)
    return text.encode("utf-8", "surrogatepass")


def _without_null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_null(each) for key, each in value.items() if each is not None}
    return [_without_null(each) for each in value] if isinstance(value, list) else value


def mutated_safetensors(random: Random, data: bytes) -> bytes:
    """Safetensors with a header mutated as JSON, overwritten numbers, or mutated bytes."""
    kind = random.randrange(4)
    if kind == 0:
        return mutated_bytes(random, data)
    length = struct.unpack("<Q", data[:8])[0]
    header, body = data[8 : 8 + length], data[8 + length :]
    if kind == 1:
        header = mutated_json(random, header)
        return struct.pack("<Q", len(header)) + header + body
    numbers = bytearray(body)
    for _ in range(random.choice((1, 1, 3, 50))):
        strange = random.choice(
            (float("nan"), float("inf"), 3.4e38, -3.4e38, -1.0, 0.0, 1e-40, 9.0)
        )
        at = random.randrange(max(len(numbers) // 4, 1)) * 4
        numbers[at : at + 4] = struct.pack("<f", strange)
    return data[: 8 + length] + bytes(numbers)


def mutated_onnx(random: Random, data: bytes) -> bytes:
    """ONNX with one to three changed fields anywhere in the graph, or with mutated bytes."""
    if random.random() < 0.25:
        return mutated_bytes(random, data)
    import onnx  # noqa: PLC0415  (an extra)

    model = onnx.load_model_from_string(data)
    for _ in range(random.choice((1, 1, 2, 3))):
        _field_changed(random, random.choice(list(_messages(model))))
    changed: bytes = model.SerializeToString()
    return changed


def _messages(message: Any) -> Iterator[Any]:
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for inner in [value] if hasattr(value, "ListFields") else value:
                yield from _messages(inner)


def _field_changed(random: Random, message: Any) -> None:
    """Clear or repeat a field that is set, or give it another value of its type."""
    if not message.ListFields():
        return
    field, value = random.choice(message.ListFields())
    kind, many = random.randrange(3), hasattr(value, "append") or hasattr(value, "add")
    if kind == 0 or (kind == 1 and not many):
        message.ClearField(field.name)
    elif field.message_type is not None:
        if many:
            value.append(random.choice(value))
    elif many:
        value[random.randrange(len(value))] = _another(random, field, value[0])
    else:
        setattr(message, field.name, _another(random, field, value))


def _another(random: Random, field: Any, value: Any) -> Any:
    if isinstance(value, str):
        return random.choice(HOSTILE)
    if isinstance(value, bytes):
        return mutated_bytes(random, value)
    if isinstance(value, float):
        return random.choice((0.0, -1.0, 1e30, float("nan"), float("inf"), value * 2.0))
    if field.enum_type is not None:
        return random.choice(field.enum_type.values).number  # protobuf accepts no others
    largest = 2**31 - 1 if field.type == field.TYPE_INT32 else 2**63 - 1
    return random.choice((0, 1, 2, 1000, -1, value + 1, 10**6, 2**31 - 1, largest, -largest))


def mutated_zip(random: Random, data: bytes) -> bytes:
    """A zip file with one part mutated, deleted, duplicated or renamed, or with mutated bytes."""
    kind = random.randrange(5)
    if kind == 0:
        return mutated_bytes(random, data)
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        parts = [(name, file.read(name)) for name in file.namelist()]
    names = [name for name, _ in parts]
    essential = [names.index("data"), names.index("policy.pth")]
    at = random.choice([*essential, random.randrange(len(names))])
    name, part = parts[at]
    if kind == 1:
        parts[at] = (random.choice(HOSTILE), part)
    elif kind == 2:
        parts[at : at + 1] = [] if random.random() < 0.5 else [(name, part)] * 2
    elif name == "data":
        parts[at] = (name, mutated_json(random, part))
    elif part[:2] == b"PK" and random.random() < 0.7:
        parts[at] = (name, _inner_mutated(random, part))
    else:
        parts[at] = (name, mutated_bytes(random, part))
    return _zipped(random, parts)


def _inner_mutated(random: Random, data: bytes) -> bytes:
    """The zip of weights with one part mutated: its pickle, or its numbers."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        parts = [(name, file.read(name)) for name in file.namelist()]
    at = random.randrange(len(parts))
    if random.random() < 0.5:
        at = next(n for n, (name, _) in enumerate(parts) if name.endswith("data.pkl"))
    parts[at] = (parts[at][0], mutated_bytes(random, parts[at][1]))
    return _zipped(random, parts, stored=True)


def _zipped(random: Random, parts: list[tuple[str, bytes]], stored: bool = False) -> bytes:
    written, how = io.BytesIO(), random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with warnings.catch_warnings(), zipfile.ZipFile(written, "w") as file:
        warnings.simplefilter("ignore")  # zipfile warns about duplicate names
        for name, part in parts:
            file.writestr(
                name.partition("\0")[0] or "x", part, zipfile.ZIP_STORED if stored else how
            )
    return written.getvalue()


def mutated_parquet(random: Random, table: pa.Table, data: bytes) -> bytes:
    """A table with changed columns, rows or metadata, or with mutated bytes.

    Half of the latter are in the last 3 kB, which hold the schema and the offsets of columns.
    """
    kind = random.randrange(6)
    if kind <= 1:
        cut = len(data) - 3000 if kind else 0
        return data[:cut] + mutated_bytes(random, data[cut:])
    metadata = dict(table.schema.metadata or {})
    if kind == 2 and metadata:
        key = random.choice(list(metadata))
        value = metadata[key]
        mutate = mutated_json if value[:1] in (b"{", b"[") else mutated_bytes
        metadata[key] = mutate(random, value)
        table = table.replace_schema_metadata(metadata)
    elif kind == 3:
        table = _rows_changed(random, table)
    else:
        table = _column_changed(random, table)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression=random.choice(("zstd", "snappy", "none")))
    written: bytes = sink.getvalue().to_pybytes()
    return written


def _rows_changed(random: Random, table: pa.Table) -> pa.Table:
    if not table.num_rows:
        return table
    at, span = random.randrange(table.num_rows), random.choice((1, 1, 5, table.num_rows))
    chosen = [random.randrange(table.num_rows) for _ in range(span)]
    kind = random.randrange(4)
    if kind == 0:
        return pa.concat_tables([table.slice(0, at), table.slice(at + span)])
    if kind == 1:
        return pa.concat_tables([table, table.take(chosen)])
    return table.take(chosen) if kind == 2 else table.slice(0, 0)


def _column_changed(random: Random, table: pa.Table) -> pa.Table:
    at = random.randrange(table.num_columns)
    name, values = table.column_names[at], table.column(at).to_pylist()
    kind = random.randrange(5)
    if kind == 0:
        return table.remove_column(at)
    if kind == 1:
        return table.append_column(name, table.column(at))
    column = table.column(at)
    if kind == 2:
        other = random.choice((pa.string(), pa.int8(), pa.float64(), pa.bool_(), pa.int64()))
        other = random.choice((other, pa.list_(pa.int8()), pa.large_string(), pa.timestamp("s")))
        values = [random.choice((None, values[0] if values else None)) for _ in values]
        try:
            column = pa.array(values, type=other)
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            column = pa.nulls(len(values), other)
    elif values:
        for _ in range(random.choice((1, 1, 5))):
            values[random.randrange(len(values))] = random.choice((None, *_STRANGE[:39]))
        try:
            column = pa.array(values, type=column.type, from_pandas=False)
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            column = pa.nulls(len(values), column.type)
    return table.set_column(at, name, column)
