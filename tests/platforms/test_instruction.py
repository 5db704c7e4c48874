"""The words that an aircraft's state calls for: the shorter way, as the simulator turns."""

import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.platforms.instruction import (
    AT_ONCE,
    NEXT_CYCLE,
    Instruction,
    shorter_turn,
    worded,
)
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
    assert worded(Instruction("AC1", level_fl=340), 0.0, actual_fl).vertical == word


def test_a_direction_that_is_given_is_to_be_obeyed():
    to_obey = Instruction("AC1", heading_deg=60, turn="left", by_direction=True)
    free, given_ = (
        worded(each, 45.0, 300.0) for each in (Instruction("AC1", heading_deg=60), to_obey)
    )
    assert (free.turn, free.by_direction) == ("right", False)
    assert (given_.turn, given_.by_direction) == ("left", True)
    assert worded(Instruction("AC1", heading_deg=360), 0.0, 300.0).turn is None


def test_half_a_turn_passes_through_no_north_or_goes_left():
    for heading, target, word in ((0.0, 180, "right"), (180.0, 360, "left"), (90.0, 270, "right")):
        told = Instruction("AC1", heading_deg=target)
        assert worded(told, heading, 300.0, NEXT_CYCLE).turn == word
        assert worded(told, heading, 300.0, AT_ONCE).turn == "left"


@given(st.floats(0.0, 359.5, width=32), HEADINGS)
def test_the_word_is_the_simulators_way_from_any_heading(actual_deg, target_deg):
    """In float32, as the simulator decides."""
    turn = float(turn_to_deg(jnp.float32([actual_deg]), jnp.float32([target_deg]))[0])
    word = shorter_turn(float(jnp.float32(actual_deg)), float(target_deg))
    if abs(turn) > 2e-3:
        assert word == ("right" if turn > 0.0 else "left")


def test_the_word_is_the_simulators_way_next_to_half_a_turn():
    targets = jnp.repeat(jnp.arange(360.0, dtype=jnp.float32), 9)
    steps = jnp.tile(jnp.arange(-4.0, 5.0, dtype=jnp.float32) * 2.0**-16, 360)
    headings = (targets + 180.0) % 360.0 + steps
    turns = turn_to_deg(headings, targets)
    for heading, target, turn in zip(headings, targets, turns, strict=True):
        word = shorter_turn(float(heading), float(target))
        assert word == ("right" if float(turn) > 0.0 else "left"), (float(heading), float(target))


def test_a_direction_to_obey_must_be_said():
    with pytest.raises(InputError, match="by_direction"):
        Instruction("AC1", heading_deg=60, by_direction=True)
