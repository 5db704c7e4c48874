"""Untrusted JSON: whole numbers, however they are written, and nothing else for them."""

import json

import msgspec
import pytest

from skystack.errors import InputError
from skystack.io.json_file import decode, read_json
from skystack.io.validation import convert


class Inner(msgspec.Struct):
    count: int = 0


class Outer(msgspec.Struct):
    count: int | None = None
    share: float = 0.0
    counts: tuple[int, ...] = ()
    inner: Inner | None = None
    text: str = ""


def by_file(values, folder):
    path = folder / "file.json"
    path.write_text(json.dumps(values))
    return convert(read_json(path), Outer)


def by_bytes(values, folder):
    return decode(json.dumps(values).encode(), Outer, "file")


@pytest.mark.parametrize("read", [by_file, by_bytes])
def test_whole_numbers_may_be_written_as_floats(read, tmp_path):
    found = read({"count": 220.0, "share": 2, "counts": [1.0, 2, -3e2, -0.0]}, tmp_path)
    assert found == Outer(220, 2.0, (1, 2, -300, 0))
    assert type(found.share) is float
    assert {type(each) for each in (found.count, *found.counts)} == {int}
    assert read({"inner": {"count": 2.0**53}}, tmp_path).inner == Inner(2**53)


@pytest.mark.parametrize("read", [by_file, by_bytes])
@pytest.mark.parametrize("value", [220.5, "220", "220.0", True, 1e300, [220]])
def test_nothing_else_is_one(read, value, tmp_path):
    with pytest.raises(InputError, match="count"):
        read({"count": value}, tmp_path)
    with pytest.raises(InputError, match="text"):
        read({"text": 220.0}, tmp_path)
