"""What an instruction may hold."""

import pytest

from skystack.errors import InputError
from skystack.platforms.instruction import Instruction


def test_a_direction_to_obey_must_be_given():
    with pytest.raises(InputError, match="by_direction"):
        Instruction("AC1", heading_deg=60, by_direction=True)
