"""Untrusted JSON: integers may be written as floats, but no other values are accepted."""

import json
import math

import msgspec
import pytest

from skystack.errors import InputError
from skystack.io.json_file import decode, finite, read_json
from skystack.io.validation import convert


class Inner(msgspec.Struct):
    count: int = 0


class Outer(msgspec.Struct):
    count: int | None = None
    share: float = 0.0
    counts: tuple[int, ...] = ()
    inner: Inner | None = None
    text: str = ""


def read_file(values, folder):
    path = folder / "file.json"
    path.write_text(json.dumps(values))
    return convert(read_json(path), Outer)


def read_bytes(values, folder):
    return decode(json.dumps(values).encode(), Outer, "file")


@pytest.mark.parametrize("read", [read_file, read_bytes])
def test_accepts_integers_written_as_floats(read, tmp_path):
    found = read({"count": 220.0, "share": 2, "counts": [1.0, 2, -3e2, -0.0]}, tmp_path)
    assert found == Outer(220, 2.0, (1, 2, -300, 0))
    assert type(found.share) is float
    assert {type(each) for each in (found.count, *found.counts)} == {int}
    assert read({"inner": {"count": 2.0**53}}, tmp_path).inner == Inner(2**53)


@pytest.mark.parametrize("read", [read_file, read_bytes])
@pytest.mark.parametrize("value", [220.5, "220", "220.0", True, 1e300, [220]])
def test_rejects_other_values_as_integers(read, value, tmp_path):
    with pytest.raises(InputError, match="count"):
        read({"count": value}, tmp_path)
    with pytest.raises(InputError, match="text"):
        read({"text": 220.0}, tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1e999", "the file is Infinity (allowed: finite number)"),
        ('"\\ud800"', 'the file is "\\ud800" (allowed: printable characters)'),
        ('{"a": [1e999]}', "a[0] is Infinity (allowed: finite number)"),
    ],
)
def test_names_the_place_of_a_refused_value(text, message, tmp_path):
    path = tmp_path / "file.json"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_json(path)
    assert str(error.value) == message


def test_non_finite_numbers_become_none():
    assert (finite(1.5), finite(math.nan), finite(-math.inf)) == (1.5, None, None)
