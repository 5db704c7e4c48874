"""Validation errors give the full path of the first wrong value, and the allowed values."""

from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from skystack.errors import MAX_INT, InputError
from skystack.io.validation import MAX_VALUE_CHARS, allowed_words, convert

Level = Annotated[int, Meta(ge=0, le=600, multiple_of=10)]


class Fix(msgspec.Struct, forbid_unknown_fields=True):
    lat: Annotated[float, Meta(ge=-75.0, le=75.0)]


class Open(msgspec.Struct):
    """Ignores unknown fields."""

    count: int = 0


class Plan(msgspec.Struct, forbid_unknown_fields=True):
    level: Level | Annotated[tuple[Level, ...], Meta(min_length=1, max_length=3)] = 300
    fixes: dict[str, Fix] = {}
    pair: tuple[int, int] = (0, 0)
    inner: str | Open | None = None
    kind: Literal["left", "right"] = "left"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (int, "whole number"),
        (float, "number"),
        (bool, "true or false"),
        (str, "text"),
        (Fix, "object"),
        (dict[str, int], "object"),
        (list[int], "list"),
        (tuple[int, int, int], "list of 3"),
        (Literal["left", "right"], "left, right"),
        (int | str | None, "whole number or text"),
        (Level, "whole number from 0 to 600, a multiple of 10"),
        (Annotated[int, Meta(ge=0, le=MAX_INT)], "whole number from 0 to 2,147,483,647"),
        (Annotated[float, Meta(gt=0.0, le=1e6)], "number above 0, up to 1,000,000"),
        (Annotated[float, Meta(ge=0.25)], "number from 0.25"),
        (Annotated[float, Meta(le=-0.5)], "number to -0.5"),
        (Annotated[list[int], Meta(min_length=2)], "list of at least 2"),
        (Annotated[list[int], Meta(max_length=10_000)], "list of at most 10,000"),
        (Annotated[str, Meta(min_length=1, max_length=40)], "text of 1 to 40 characters"),
        (Annotated[str, Meta(pattern="^[A-Z]+$", description="capitals")], "capitals"),
    ],
)
def test_describes_the_allowed_values_of_a_type(kind, words):
    assert allowed_words(kind) == words


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ({"fixes": {"EGL": {"lat": 1}, "ALB": {"lat": 91}}}, "fixes.ALB.lat is 91 (allowed: numb"),
        ({"fixes": {"EGL": {}}}, "fixes.EGL.lat is missing"),
        ({"fixes": {"EGL": {"lat": 1, "alt": 2}}}, "fixes.EGL: unknown field 'alt'; did you mean"),
        ({"fixes": [1]}, "fixes is [1] (allowed: object)"),
        ({"fixs": {}}, "unknown field 'fixs'; did you mean 'fixes'? (allowed: fixes, inner, "),
        ({"level": "high"}, 'level is "high" (allowed: whole number from 0 to 600, a multiple'),
        ({"level": [300, 305]}, "level[1] is 305 (allowed: whole number from 0 to 600, a mult"),
        (
            {"level": []},
            "level is [] (allowed: whole number from 0 to 600, a multiple of 10 or list",
        ),
        ({"pair": [1, True]}, "pair[1] is true (allowed: whole number)"),
        ({"pair": [1, 2, 3]}, "pair is [1, 2, 3] (allowed: list of 2)"),
        ({"inner": {"count": "x", "more": 1}}, 'inner.count is "x" (allowed: whole number)'),
        ({"inner": 3}, "inner is 3 (allowed: text or object)"),
        ({"kind": "up"}, 'kind is "up" (allowed: left, right)'),
        ([1], "the file is [1] (allowed: object)"),
    ],
)
def test_names_the_first_wrong_value(raw, message):
    with pytest.raises(InputError) as error:
        convert(raw, Plan)
    assert str(error.value).startswith(message)


def test_long_values_are_truncated():
    with pytest.raises(InputError) as error:
        convert({"kind": "x" * 1000}, Plan)
    assert str(error.value) == f'kind is "{"x" * (MAX_VALUE_CHARS - 1)}... (allowed: left, right)'


def test_converts_valid_values():
    found = convert({"level": [300, 310], "fixes": {"EGL": {"lat": 1}}, "inner": {"x": 1}}, Plan)
    assert found == Plan(level=(300, 310), fixes={"EGL": Fix(1.0)}, inner=Open())
    assert convert({"a": [1, "b", None]}, Any) == {"a": [1, "b", None]}
