"""The words that an aircraft's state calls for: the shorter way, as the simulator turns."""

import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.platforms.instruction import Instruction, shorter_turn, worded
from skystack.simulator.simulator import turn_to_deg

HEADINGS = st.integers(0, 359)


@given(HEADINGS, HEADINGS)
def test_the_word_is_the_way_that_the_simulator_turns(actual_deg, target_deg):
    turn = turn_to_deg(jnp.float32([actual_deg]), jnp.float32([target_deg]))[0]
    word = {1.0: "right", -1.0: "left", 0.0: None}[float(jnp.sign(turn))]
    assert shorter_turn(float(actual_deg), float(target_deg)) == word


@pytest.mark.parametrize(
    ("actual_fl", "word"), [(300.0, "climb"), (340.0, None), (340.5, "descend")]
)
def test_a_level_is_climbed_or_descended_to(actual_fl, word):
    assert worded("AC1", None, 340, 0.0, actual_fl).vertical == word


def test_a_direction_that_is_given_is_to_be_obeyed():
    free, given_ = worded("AC1", 60, None, 45.0, 0.0), worded("AC1", 60, None, 45.0, 0.0, "left")
    assert (free.turn, free.by_direction) == ("right", False)
    assert (given_.turn, given_.by_direction) == ("left", True)
    assert worded("AC1", 360, None, 0.0, 0.0).turn is None


def test_a_direction_to_obey_must_be_said():
    with pytest.raises(InputError, match="by_direction"):
        Instruction("AC1", heading_deg=60, by_direction=True)
