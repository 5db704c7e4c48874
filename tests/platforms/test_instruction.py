"""What an instruction may hold."""

import pytest

from skystack.errors import InputError
from skystack.platforms.instruction import Instruction


def test_a_direction_to_obey_must_be_given():
    with pytest.raises(InputError, match="by_direction"):
        Instruction("AC1", heading_deg=60, by_direction=True)


@pytest.mark.parametrize("fields", [{"heading_deg": 0}, {"heading_deg": 360}, {"level_fl": 0}])
def test_the_least_and_the_greatest_values_are_accepted(fields):
    assert Instruction("AC1", **fields).callsign == "AC1"


@pytest.mark.parametrize("fields", [{"heading_deg": 361}, {"heading_deg": -1}, {"level_fl": -1}])
def test_values_beyond_the_limits_are_refused(fields):
    (name,) = fields
    with pytest.raises(InputError, match=f"^{name} is {fields[name]} "):
        Instruction("AC1", **fields)
