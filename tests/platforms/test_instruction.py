"""Validation of instructions."""

import pytest

from skystack.errors import InputError
from skystack.platforms.instruction import Instruction


def test_by_direction_requires_a_direction():
    with pytest.raises(InputError, match="by_direction"):
        Instruction("AC1", heading_deg=60, by_direction=True)


@pytest.mark.parametrize("fields", [{"heading_deg": 0}, {"heading_deg": 360}, {"level_fl": 0}])
def test_accepts_values_at_the_limits(fields):
    assert Instruction("AC1", **fields).callsign == "AC1"


@pytest.mark.parametrize("fields", [{"heading_deg": 361}, {"heading_deg": -1}, {"level_fl": -1}])
def test_rejects_values_beyond_the_limits(fields):
    (name,) = fields
    with pytest.raises(InputError, match=f"^{name} is {fields[name]} "):
        Instruction("AC1", **fields)
