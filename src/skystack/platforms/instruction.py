"""What one aircraft is told in one transmission: the one value behind every language."""

from dataclasses import dataclass
from typing import Literal

from skystack.errors import InputError


@dataclass(frozen=True)
class Instruction:
    """A heading, a level or both, absolute. Raises InputError if it cannot be said."""

    callsign: str
    heading_deg: int | None = None
    """Whole degrees in [0, 360]; 0 and 360 are the same."""
    turn: Literal["left", "right"] | None = None
    """The way to turn, where it is said."""
    by_direction: bool = False
    """Turn the way that is said even where it is the longer one; else always the shorter way."""
    level_fl: int | None = None
    vertical: Literal["climb", "descend"] | None = None
    """Which way the level lies; None where it is the one being flown."""

    def __post_init__(self) -> None:
        if self.heading_deg is None and self.level_fl is None:
            raise InputError(f"an instruction to {self.callsign} needs heading_deg or level_fl")
        if self.heading_deg is not None and not 0 <= self.heading_deg <= 360:
            raise InputError(f"heading_deg is {self.heading_deg} (allowed: 0 to 360)")
        if self.level_fl is not None and self.level_fl < 0:
            raise InputError(f"level_fl is {self.level_fl} (allowed: 0 and more)")
        if self.turn is not None and self.heading_deg is None:
            raise InputError(f"turn is {self.turn!r} (allowed: only together with heading_deg)")
        if self.by_direction and self.turn is None:
            raise InputError("by_direction is true (allowed: only together with turn)")
        if self.vertical is not None and self.level_fl is None:
            raise InputError(
                f"vertical is {self.vertical!r} (allowed: only together with level_fl)"
            )


def shorter_turn(actual_deg: float, target_deg: float) -> Literal["left", "right"] | None:
    """The way that a turn goes if it is free to choose; None where there is nothing to turn."""
    turn = (target_deg - actual_deg) % 360.0
    if turn == 0.0:
        return None
    # Half a turn passes through no north, as in the simulator.
    right = target_deg > actual_deg if turn == 180.0 else turn < 180.0
    return "right" if right else "left"


def worded(
    callsign: str,
    heading_deg: int | None,
    level_fl: int | None,
    actual_heading_deg: float,
    actual_fl: float | None = None,
    turn: Literal["left", "right"] | None = None,
) -> Instruction:
    """An instruction with the words that the aircraft's present state calls for.

    `turn` is given where the direction is to be obeyed; without it the shorter way is said. The
    actual level is needed only with a level.
    """
    if heading_deg is not None and turn is None:
        said = shorter_turn(actual_heading_deg, heading_deg % 360)
    else:
        said = turn
    vertical: Literal["climb", "descend"] | None = None
    if level_fl is not None and actual_fl is not None and level_fl != actual_fl:
        vertical = "climb" if level_fl > actual_fl else "descend"
    return Instruction(callsign, heading_deg, said, turn is not None, level_fl, vertical)
