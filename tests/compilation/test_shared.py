"""Equal objects share programs; others do not."""

from dataclasses import dataclass

from skystack.compilation.shared import shared_program


@dataclass(frozen=True)
class Scale:
    factor: float

    def apply(self, value):
        return self.factor * value


@dataclass(frozen=True)
class WithoutHash(Scale):
    __hash__ = None


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


def test_constants_without_a_hash_have_a_program_of_their_own():
    one, two = (shared_program(Scale.apply, WithoutHash(2.0)) for _ in range(2))
    assert one is not two
    assert float(one(3.0)) == float(two(3.0)) == 6.0


def test_programs_have_the_names_of_their_functions():
    assert "apply" in shared_program(Scale.apply, Scale(2.0)).lower(1.0).as_text()
