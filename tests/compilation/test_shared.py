"""Equal values share programs; others do not."""

from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from skystack.airspace.sector_file import SectorEntry
from skystack.compilation.shared import is_value, shared_program
from skystack.compilation.subroutine import subroutine


@dataclass(frozen=True)
class Scale:
    factor: float

    def apply(self, value):
        return self.factor * value


class Shifted(Scale):
    """Inherits an equality that ignores the shift."""

    def __init__(self, factor, shift):
        super().__init__(factor)
        object.__setattr__(self, "shift", shift)

    def apply(self, value):
        return self.factor * value + self.shift


@dataclass
class Changeable:
    factor: float

    __hash__ = object.__hash__

    def apply(self, value):
        return self.factor * value


@dataclass(frozen=True)
class Table:
    values: np.ndarray

    def __hash__(self):
        return 1

    def apply(self, value):
        return value * float(self.values[0])


@dataclass(frozen=True)
class PartlyCompared:
    factor: float
    shift: float = field(compare=False)


class Point(msgspec.Struct, frozen=True):
    lat: float


class ChangeablePoint(msgspec.Struct):
    lat: float


def test_equal_constants_share_a_program():
    program = shared_program(Scale.apply, Scale(2.0))
    assert program is shared_program(Scale.apply, Scale(2.0))
    assert float(program(3.0)) == 6.0


def test_methods_of_equal_objects_share_a_program():
    assert shared_program(Scale(2.0).apply) is shared_program(Scale.apply, Scale(2.0))
    assert shared_program(Scale(2.0).apply) is not shared_program(Scale(3.0).apply)


def test_other_constants_have_another_program():
    program = shared_program(Scale.apply, Scale(3.0))
    assert program is not shared_program(Scale.apply, Scale(2.0))
    assert float(program(3.0)) == 9.0
    assert shared_program(round, 1) is not shared_program(round, 1.0)


@pytest.mark.parametrize(
    "make",
    [lambda: Shifted(2.0, 1.0), lambda: Changeable(2.0), lambda: Table(np.array([2.0, 3.0]))],
    ids=["subclass", "changeable", "array"],
)
def test_what_is_not_a_value_has_a_program_of_its_own(make):
    one, two = make(), make()
    programs = shared_program(one.apply), shared_program(two.apply)
    assert programs[0] is not programs[1]
    assert [float(each(3.0)) for each in programs] == [float(one.apply(3.0))] * 2


@pytest.mark.parametrize("thing", [Shifted(2.0, 1.0), Changeable(2.0), Table(np.array([2.0]))])
def test_subroutines_of_other_objects_still_work(thing):
    expected = float(thing.apply(3.0))
    for program in (lambda x: subroutine(thing.apply, x), lambda x: subroutine(thing.apply, x) * 1):
        assert float(jax.jit(program)(3.0)) == expected


def test_a_changed_object_is_noticed():
    thing = Changeable(2.0)
    assert float(jax.jit(lambda x: subroutine(thing.apply, x))(3.0)) == 6.0
    thing.factor = 5.0
    assert float(jax.jit(lambda x: subroutine(thing.apply, x))(3.0)) == 15.0


def test_what_is_traced_can_be_bound():
    def program(x):
        return subroutine(partial(jnp.add, x), x)

    assert float(jax.jit(program)(3.0)) == 6.0


ENTRY = SectorEntry("here", (100, 200), {"type": "Polygon", "coordinates": [[0.0]]}, {}, ())


@pytest.mark.parametrize(
    ("thing", "expected"),
    [
        (1.0, True),
        (("a", None, len), True),
        ((np.zeros(2),), False),
        (Scale(2.0), True),
        (Scale(Scale(2.0)), True),
        (Scale(np.float32(2.0)), False),
        (PartlyCompared(1.0, 2.0), False),
        (Point(1.0), True),
        (ChangeablePoint(1.0), False),
        (ENTRY, True),
    ],
)
def test_values_are_what_cannot_change(thing, expected):
    assert is_value(thing) is expected


def test_equal_sector_entries_share():
    same = msgspec.structs.replace(ENTRY, fixes=dict(ENTRY.fixes))
    assert shared_program(repr, ENTRY) is shared_program(repr, same)
    other = msgspec.structs.replace(ENTRY, separation_nm=3.0)
    assert shared_program(repr, ENTRY) is not shared_program(repr, other)


def test_programs_have_the_names_of_their_functions_and_arguments():
    text = shared_program(Scale.apply, Scale(2.0)).lower(1.0).as_text(debug_info=True)
    assert "jit_apply" in text
    assert '"value"' in text
