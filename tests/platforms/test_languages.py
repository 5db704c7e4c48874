"""The same instruction in every language.

Expected texts are from the documentation of BluebirdDT and BlueSky, and from the message elements
of ICAO Doc 4444, Appendix 5.
"""

import pytest

from skystack.platforms.instruction import Instruction
from skystack.platforms.languages import bluebird_actions, bluesky_commands, cpdlc
from skystack.platforms.phraseology import spoken, written

LEFT = Instruction("AC1", 215, "left")
HEADING_AND_LEVEL = Instruction("AC1", 5, "right", level_fl=340, vertical="climb")
DESCENT = Instruction("AC1", level_fl=90, vertical="descend")
NORTH = Instruction("AC1", 360)
MAINTAIN = Instruction("AC1", level_fl=300)
LONG_WAY = Instruction("AC1", 90, "left", by_direction=True)

TRANSLATIONS = [
    (
        LEFT,
        [("change_heading_to", 215)],
        ["HDG AC1 215"],
        "TURN LEFT HEADING 215",
        "AC1 turn left heading 215",
        "AC1 turn left heading two one five",
    ),
    (
        HEADING_AND_LEVEL,
        [("change_heading_to", 5), ("change_flight_level_to", 340)],
        ["HDG AC1 005", "ALT AC1 FL340"],
        "TURN RIGHT HEADING 005 / CLIMB TO FL340",
        "AC1 turn right heading 005, climb FL340",
        "AC1 turn right heading zero zero five, climb flight level three four zero",
    ),
    (
        DESCENT,
        [("change_flight_level_to", 90)],
        ["ALT AC1 FL090"],
        "DESCEND TO FL090",
        "AC1 descend FL90",
        "AC1 descend flight level niner zero",
    ),
    (
        NORTH,
        [("change_heading_to", 0)],
        ["HDG AC1 000"],
        "FLY HEADING 360",
        "AC1 fly heading 360",
        "AC1 fly heading three six zero",
    ),
    (
        MAINTAIN,
        [("change_flight_level_to", 300)],
        ["ALT AC1 FL300"],
        "MAINTAIN FL300",
        "AC1 maintain FL300",
        "AC1 maintain flight level three hundred",
    ),
    (
        Instruction("AC1", direct_to="EGL", level_fl=220, vertical="descend"),
        [("route_direct_to", "EGL"), ("change_flight_level_to", 220)],
        ["ALT AC1 FL220"],  # fixes are positions, see test_bluesky_scenario
        "PROCEED DIRECT TO EGL / DESCEND TO FL220",
        "AC1 resume own navigation direct EGL, descend FL220",
        "AC1 resume own navigation direct EGL, descend flight level two two zero",
    ),
    (
        LONG_WAY,
        [("change_heading_to_by_direction", (90, "left"))],
        ["HDG AC1 090"],
        "TURN LEFT HEADING 090",
        "AC1 turn left heading 090",
        "AC1 turn left heading zero niner zero",
    ),
]


@pytest.mark.parametrize(
    ("instruction", "bluebird", "bluesky", "uplink", "text", "speech"), TRANSLATIONS
)
def test_translates_instructions_into_every_language(
    instruction, bluebird, bluesky, uplink, text, speech
):
    assert bluebird_actions(instruction) == bluebird
    assert bluesky_commands(instruction) == bluesky
    assert cpdlc(instruction) == uplink
    assert written(instruction) == text
    assert spoken(instruction) == speech
