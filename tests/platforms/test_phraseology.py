"""Phraseology: the words of ICAO Doc 4444 and Annex 10, without loss of information."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.platforms.instruction import Instruction
from skystack.platforms.phraseology import DIGITS, spoken, written

EXAMPLES = [
    (
        Instruction("AC1", heading_deg=215, turn="left"),
        "AC1 turn left heading 215",
        "AC1 turn left heading two one five",
    ),
    (
        Instruction("AC1", level_fl=340, vertical="climb"),
        "AC1 climb FL340",
        "AC1 climb flight level three four zero",
    ),
    (
        Instruction("AC1", heading_deg=215, turn="left", level_fl=340, vertical="climb"),
        "AC1 turn left heading 215, climb FL340",
        "AC1 turn left heading two one five, climb flight level three four zero",
    ),
    (
        Instruction("BAW 12", heading_deg=45, turn="right"),
        "BAW 12 turn right heading 045",
        "BAW 12 turn right heading zero four five",
    ),
    (
        Instruction("AC1", heading_deg=0),
        "AC1 fly heading 360",
        "AC1 fly heading three six zero",
    ),
    (
        Instruction("AC1", heading_deg=100, level_fl=290, vertical="descend"),
        "AC1 fly heading 100, descend FL290",
        "AC1 fly heading one zero zero, descend flight level two niner zero",
    ),
    (
        Instruction("AC1", level_fl=300),
        "AC1 maintain FL300",
        "AC1 maintain flight level three hundred",
    ),
    (
        Instruction("AC1", level_fl=100, vertical="descend"),
        "AC1 descend FL100",
        "AC1 descend flight level one hundred",
    ),
    (
        Instruction("AC1", level_fl=80, vertical="descend"),
        "AC1 descend FL80",
        "AC1 descend flight level eight zero",
    ),
]


@pytest.mark.parametrize(("instruction", "text", "speech"), EXAMPLES)
def test_written_and_spoken_phrases(instruction, text, speech):
    assert written(instruction) == text
    assert spoken(instruction) == speech


def number(words: str) -> int:
    """The number that spoken digits stand for, with an optional final "hundred"."""
    *digits, last = words.split()
    if last == "hundred":
        return 100 * number(" ".join(digits))
    return int("".join(str(DIGITS.index(word)) for word in [*digits, last]))


@given(st.integers(0, 360))
def test_headings_have_three_digits_and_the_right_value(heading_deg):
    instruction = Instruction("AC1", heading_deg=heading_deg)
    digits = written(instruction).removeprefix("AC1 fly heading ")
    words = spoken(instruction).removeprefix("AC1 fly heading ")
    assert len(digits) == len(words.split()) == 3
    assert int(digits) == number(words)
    assert 1 <= int(digits) <= 360
    assert (int(digits) - heading_deg) % 360 == 0


@given(st.integers(0, 60).map(lambda tens: 10 * tens))
def test_levels_have_the_right_value(level_fl):
    instruction = Instruction("AC1", level_fl=level_fl, vertical="climb")
    assert written(instruction) == f"AC1 climb FL{level_fl}"
    words = spoken(instruction).removeprefix("AC1 climb flight level ")
    assert number(words) == level_fl
    assert ("hundred" in words) == (level_fl > 0 and level_fl % 100 == 0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "an instruction to AC1 needs heading_deg, direct_to or level_fl"),
        (
            {"heading_deg": 45, "direct_to": "EGL"},
            "direct_to is 'EGL' (allowed: only without heading_deg)",
        ),
        ({"heading_deg": 361}, "heading_deg is 361 (allowed: 0 to 360)"),
        ({"heading_deg": -1}, "heading_deg is -1 (allowed: 0 to 360)"),
        ({"level_fl": -10}, "level_fl is -10 (allowed: 0 or more)"),
        (
            {"level_fl": 300, "turn": "left"},
            "turn is 'left' (allowed: only together with heading_deg)",
        ),
        (
            {"heading_deg": 45, "vertical": "climb"},
            "vertical is 'climb' (allowed: only together with level_fl)",
        ),
    ],
)
def test_rejects_invalid_instructions(fields, message):
    with pytest.raises(InputError) as error:
        Instruction("AC1", **fields)
    assert str(error.value) == message
