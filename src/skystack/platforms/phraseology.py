"""Clearances in words: the phraseology of ICAO Doc 4444 (section 12.3) and Annex 10, Volume II.

Headings have three digits, spoken one by one, and north is 360. Levels have no leading zeros; whole
hundreds are spoken as hundreds. Instructions state absolute values, never changes.
"""

from collections.abc import Callable

from skystack.platforms.instruction import Instruction

DIGITS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "niner")


def written(instruction: Instruction) -> str:
    """The instruction in writing: "AC1 turn left heading 215, climb FL340"."""
    return _phrase(instruction, _three_digits, lambda level_fl: f"FL{level_fl}")


def spoken(instruction: Instruction) -> str:
    """The words spoken: "AC1 turn left heading two one five, climb flight level three four zero".

    The callsign is not spelled out.
    """
    return _phrase(instruction, _spoken_heading, _spoken_level)


def read_back(instruction: Instruction) -> str:
    """What the pilot reads back: the clearance, then the callsign."""
    return f"{clearance_alone(instruction)}, {instruction.callsign}"


def clearance_alone(instruction: Instruction) -> str:
    """The instruction in writing, without the callsign."""
    return written(instruction).removeprefix(f"{instruction.callsign} ")


def _phrase(
    instruction: Instruction, heading: Callable[[int], str], level: Callable[[int], str]
) -> str:
    parts = []
    if instruction.heading_deg is not None:
        verb = f"turn {instruction.turn}" if instruction.turn else "fly"
        parts.append(f"{verb} heading {heading(instruction.heading_deg)}")
    if instruction.direct_to is not None:
        parts.append(f"resume own navigation direct {instruction.direct_to}")
    if instruction.level_fl is not None:
        parts.append(f"{instruction.vertical or 'maintain'} {level(instruction.level_fl)}")
    return f"{instruction.callsign} {', '.join(parts)}"


def _three_digits(heading_deg: int) -> str:
    return f"{heading_deg % 360 or 360:03d}"


def _digit_by_digit(number: str) -> str:
    return " ".join(DIGITS[int(digit)] for digit in number)


def _spoken_heading(heading_deg: int) -> str:
    return _digit_by_digit(_three_digits(heading_deg))


def _spoken_level(level_fl: int) -> str:
    hundreds, rest = divmod(level_fl, 100)
    if hundreds and not rest:
        return f"flight level {_digit_by_digit(str(hundreds))} hundred"
    return f"flight level {_digit_by_digit(str(level_fl))}"
