"""Clearances in words are understood as they are meant, or refused with a reason."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.live.clearance_text import ParsedClearance, parse_clearance
from skystack.platforms.instruction import Instruction
from skystack.platforms.phraseology import spoken, written

CALLSIGNS = ("BAW12", "EZY7AB", "AC1")


def of_baw12(**elements):
    return ParsedClearance("BAW12", **elements)


LEFT_240 = {"turn": "left", "heading_deg": 240}
CLIMB_340 = {"level_fl": 340, "vertical": "climb"}
TO_FIRE = {"direct_to": "FIRE", "own_navigation": True}


@pytest.mark.parametrize(
    ("text", "elements"),
    [
        ("BAW12 left heading 240 climb 340", LEFT_240 | CLIMB_340),
        ("baw12 turn left heading 240, climb FL340", LEFT_240 | CLIMB_340),
        ("BAW12 right 090", {"turn": "right", "heading_deg": 90}),
        ("BAW12 fly heading 000", {"heading_deg": 360}),
        ("BAW12 heading three six zero", {"heading_deg": 360}),
        ("BAW12 turn right 30 degrees", {"turn": "right", "by_deg": 30}),
        ("BAW12 descend to flight level two niner zero", {"level_fl": 290, "vertical": "descend"}),
        ("BAW12 climb and maintain flight level three four zero", CLIMB_340),
        ("BAW12 maintain flight level three hundred", {"level_fl": 300}),
        ("BAW12 fl 310", {"level_fl": 310}),
        ("BAW12 direct fire", TO_FIRE),
        ("BAW12 resume own navigation", {"own_navigation": True}),
        ("BAW12 resume own navigation direct to FIRE, climb FL340", TO_FIRE | CLIMB_340),
    ],
)
def test_understands(text, elements):
    assert parse_clearance(text, CALLSIGNS) == of_baw12(**elements)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "an empty text"),
        ("BAW12", "no clearance for BAW12"),
        ("BAW13 left heading 240", "unknown callsign 'BAW13'; did you mean 'BAW12'"),
        ("BAW12 left heading 20", "heading '20' (allowed: three digits, 001 to 360)"),
        ("BAW12 left 20", "heading '20' (allowed: three digits, 001 to 360)"),
        ("BAW12 heading 361", "heading '361' (allowed: three digits, 001 to 360)"),
        ("BAW12 heading", "heading '' (allowed: three digits, 001 to 360)"),
        ("BAW12 left 200 degrees", "a turn of 200 degrees (allowed: 1 to 180)"),
        ("BAW12 climb high", "flight level 'high' (allowed: up to three digits)"),
        ("BAW12 climb 340 descend 320", "more than one level"),
        ("BAW12 left heading 240 right heading 250", "more than one heading"),
        ("BAW12 left 10 degrees right heading 250", "more than one"),
        ("BAW12 heading 240 direct FIRE", "a heading and own navigation"),
        ("BAW12 direct", "direct without a fix"),
        ("BAW12 turn", "'turn' was not understood"),
        ("BAW12 resume navigation", "'navigation' was not understood"),
        ("BAW12 squawk 1234", "'squawk' was not understood"),
        ("BAW12 heading 2\u0664\u0660", "allowed: three digits"),
        ("BAW12 " + "left " * 100, "a clearance of 506 characters (allowed: at most 200)"),
    ],
)
def test_refuses(text, message):
    with pytest.raises(InputError) as refused:
        parse_clearance(text, CALLSIGNS)
    assert message in str(refused.value)


headings = st.none() | st.integers(1, 360)
levels = st.none() | st.integers(0, 999)


@given(
    st.sampled_from(CALLSIGNS),
    headings,
    st.sampled_from([None, "left", "right"]),
    levels,
    st.sampled_from([None, "climb", "descend"]),
    st.none() | st.sampled_from(["FIRE", "EARTH"]),
    st.sampled_from([written, spoken]),
)
def test_understands_everything_that_is_written(
    callsign, heading, turn, level, vertical, fix, words
):
    if heading is not None:
        fix = None
    elif turn is not None:
        turn = None
    if level is None:
        vertical = None
    if heading is None and level is None and fix is None:
        return
    instruction = Instruction(
        callsign, heading, turn, level_fl=level, vertical=vertical, direct_to=fix
    )
    assert parse_clearance(words(instruction), CALLSIGNS) == ParsedClearance(
        callsign, heading, turn, None, level, vertical, fix, fix is not None
    )


@given(st.text())
def test_never_fails_with_anything_but_a_message(text):
    for beginning in ("", "AC1 ", "AC1 climb "):
        with suppress(InputError):
            parse_clearance(beginning + text, CALLSIGNS)


def test_a_callsign_that_differs_from_another_only_in_case_is_found_exactly():
    assert parse_clearance("ac1 climb 340", ["AC1", "ac1"]).callsign == "ac1"
    with pytest.raises(InputError, match="unknown callsign 'Ac1'"):
        parse_clearance("Ac1 climb 340", ["AC1", "ac1"])


@pytest.mark.parametrize(
    ("text", "callsign"),
    [
        ("BAW 12 climb 340", "BAW 12"),
        ("baw 12 climb 340", "BAW 12"),
        ("BAW climb 340", "BAW"),
        ("BAW, 12, climb 340", "BAW 12"),
        ("G-A.B climb 340", "G-A.B"),
    ],
)
def test_a_callsign_may_have_several_words(text, callsign):
    assert parse_clearance(text, ["BAW", "BAW 12", "G-A.B"]).callsign == callsign
