"""Find every text in a file of any format, and replace one of them.

Texts are found by walking a valid file: values, and names of fields, columns, tensors and parts.
"""

import io
import json
import struct
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

Place = tuple[Any, ...]
"""Keys and indices that lead to a text; the last is None if the text is the key before it."""


@lru_cache(maxsize=256)
def texts_in(name: str, data: bytes) -> tuple[Place, ...]:
    """The places of all texts in a file. Raises ValueError for a file of another format."""
    return tuple(_places(_opened(Path(name).suffix, data)))


def text_at(name: str, data: bytes, place: Place) -> str:
    """The text at one place."""
    if place[-1] is None:
        return str(place[-2])
    value = _opened(Path(name).suffix, data)
    for step in place:
        value = value[step]
    return str(value)


def with_text(name: str, data: bytes, place: Place, text: str) -> bytes:
    """The file with another text at one place.

    Raises ValueError if the format cannot hold it, such as a lone surrogate in Parquet.
    """
    whole = deepcopy(_opened(Path(name).suffix, data))
    holder, (*steps, last) = whole, place
    renamed = last is None
    if renamed:
        *steps, last = steps
    for step in steps:
        holder = holder[step]
    if renamed:  # in the same position
        items = [(text if key == last else key, value) for key, value in holder.items()]
        holder.clear()
        holder.update(items)
    else:
        holder[last] = text
    return _closed(Path(name).suffix, data, whole)


def _places(value: Any, before: Place = ()) -> Iterator[Place]:
    if isinstance(value, str):
        yield before
    elif isinstance(value, dict):
        for key, each in value.items():
            if isinstance(key, str):  # `_opened` adds keys that are not strings
                yield (*before, key, None)
            yield from _places(each, (*before, key))
    elif isinstance(value, list):
        for index, each in enumerate(value):
            yield from _places(each, (*before, index))


@lru_cache(maxsize=256)
def _opened(kind: str, data: bytes) -> Any:
    """A file as nested lists and objects that contain its texts."""
    if kind in (".json", ".geojson"):
        return json.loads(data)
    others: dict[str, Callable[[bytes], Any]] = {
        ".jsonl": lambda data: [json.loads(line) for line in data.splitlines()],
        ".toml": lambda data: tomllib.loads(data.decode()),
        ".safetensors": lambda data: _header(data)[0],
        ".parquet": _table,
        ".onnx": lambda data: [text for _, _, text in _message_texts(_model(data))],
        ".zip": _zip,
    }
    return others[kind](data)


def _closed(kind: str, data: bytes, whole: Any) -> bytes:
    """The file with the contents `whole`, a changed result of `_opened`."""
    if kind in (".json", ".geojson"):
        return json.dumps(whole).encode()
    others: dict[str, Callable[[bytes, Any], bytes]] = {
        ".jsonl": lambda _, lines: "\n".join(json.dumps(line) for line in lines).encode(),
        ".toml": lambda _, values: tomli_w.dumps(values).encode(),
        ".safetensors": _safetensors,
        ".parquet": _parquet,
        ".onnx": _onnx,
        ".zip": _zipped,
    }
    return others[kind](data, whole)


def _safetensors(data: bytes, header: Any) -> bytes:
    written = json.dumps(header).encode()
    return struct.pack("<Q", len(written)) + written + _header(data)[1]


def _header(data: bytes) -> tuple[Any, bytes]:
    end = 8 + struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8:end]), data[end:]


def _table(data: bytes) -> dict[Any, Any]:
    """The names of columns, one text of each text column, and the metadata."""
    table = pq.read_table(pa.BufferReader(data))
    metadata = table.schema.metadata or {}
    first = {
        (name,): str(table[name][0])
        for name in table.column_names
        if table.num_rows and _holds_texts(table[name].type)
    }
    return {
        ("columns",): dict.fromkeys(table.column_names, 0),
        ("first",): first,
        ("metadata",): {
            key.decode(): json.loads(value) if value[:1] in (b"{", b"[") else value.decode()
            for key, value in metadata.items()
        },
    }


def _holds_texts(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind.value_type if pa.types.is_dictionary(kind) else kind))


def _parquet(data: bytes, whole: Any) -> bytes:
    """The table with the changed text in every row that had the old one."""
    table = pq.read_table(pa.BufferReader(data))
    known = _table(data)["first",]
    for (name,), text in whole["first",].items():
        first = known[name,]
        if text != first:
            values = [text if each == first else each for each in table[name].to_pylist()]
            at = table.column_names.index(name)
            table = table.set_column(at, name, pa.array(values, type=pa.string()))
    metadata = {
        key: value if isinstance(value, str) else json.dumps(value)
        for key, value in whole["metadata",].items()
    }
    table = table.rename_columns(list(whole["columns",])).replace_schema_metadata(metadata)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    written: bytes = sink.getvalue().to_pybytes()
    return written


def _model(data: bytes) -> Any:
    import onnx  # noqa: PLC0415  (an extra)

    return onnx.load_model_from_string(data)


def _message_texts(message: Any) -> Iterator[tuple[Any, Any, str]]:
    """The texts in a protobuf message, nested ones included: message, field and index, text."""
    for field, value in message.ListFields():
        many = not isinstance(value, str | bytes | int | float) and not hasattr(value, "ListFields")
        if field.message_type is not None:
            for inner in value if many else [value]:
                yield from _message_texts(inner)
        elif field.type == field.TYPE_STRING:
            for index, text in enumerate(value if many else [value]):
                yield message, (field.name, index if many else None), text


def _onnx(data: bytes, whole: Any) -> bytes:
    model = _model(data)
    for (holder, (name, index), old), new in zip(list(_message_texts(model)), whole, strict=True):
        if new != old and index is None:
            setattr(holder, name, new)
        elif new != old:
            getattr(holder, name)[index] = new
    written: bytes = model.SerializeToString()
    return written


def _zip(data: bytes) -> dict[Any, Any]:
    """A model of Stable-Baselines3: its parts, its description and the names of its tensors."""
    import torch  # noqa: PLC0415  (an extra)

    with zipfile.ZipFile(io.BytesIO(data)) as file:
        parts = dict.fromkeys(file.namelist(), 0)
        described = json.loads(file.read("data"))
        tensors = torch.load(io.BytesIO(file.read("policy.pth")), weights_only=True)
    names = dict.fromkeys(tensors, 0)
    return {("parts",): parts, ("data",): described, ("tensors",): names}


def _zipped(data: bytes, whole: Any) -> bytes:
    import torch  # noqa: PLC0415

    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(written, "w") as new:
        for name, as_name in zip(old.namelist(), whole["parts",], strict=True):
            part = old.read(name)
            if name == "data":
                part = json.dumps(whole["data",]).encode()
            elif name == "policy.pth" and whole["tensors",] != _zip(data)["tensors",]:
                tensors = torch.load(io.BytesIO(part), weights_only=True)
                saved = io.BytesIO()
                torch.save(dict(zip(whole["tensors",], tensors.values(), strict=True)), saved)
                part = saved.getvalue()
            if not as_name.partition("\0")[0]:  # zipfile cuts names at a null character
                raise ValueError("the name of a part is empty")
            new.writestr(as_name, part)
    return written.getvalue()
