"""What one aircraft is cleared to in one transmission: the one value behind every language."""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from skystack.errors import InputError

SAME_DEG, SAME_FL = 1e-3, 1e-6
"""Differences below these are rounding of a simulator, not a turn or a climb."""


class Adoption(NamedTuple):
    """When and how a simulator begins to fly a clearance; the words must be of what it flies."""

    at_once: bool
    """From the state in which it was issued; else from that one cycle later."""
    half_turn_left: bool
    """Half a turn goes to the left; else it passes through no north."""


NEXT_CYCLE = Adoption(at_once=False, half_turn_left=False)
"""Our simulator and BluebirdDT."""
AT_ONCE = Adoption(at_once=True, half_turn_left=True)
"""BlueSky."""


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


def shorter_turn(
    actual_deg: float, target_deg: float, half_turn_left: bool = False
) -> Literal["left", "right"] | None:
    """The way that a turn goes if it is free to choose; None where there is nothing to turn.

    Half a turn passes through no north, or goes to the left.
    """
    turn = (target_deg - actual_deg) % 360.0
    if min(turn, 360.0 - turn) < SAME_DEG:
        return None
    if turn == 180.0:
        return "right" if target_deg > actual_deg and not half_turn_left else "left"
    return "right" if turn < 180.0 else "left"


def worded(
    instruction: Instruction,
    heading_deg: float,
    fl: float,
    adoption: Adoption = NEXT_CYCLE,
) -> Instruction:
    """An instruction with the direction of turn and of level that will be flown.

    `heading_deg` and `fl` are the aircraft's in the state in which the simulator adopts it, see
    `Adoption`. A direction that was given stays, unless there is nothing to turn.
    """
    turn, by_direction, vertical = instruction.turn, instruction.by_direction, instruction.vertical
    if instruction.heading_deg is not None:
        target_deg = instruction.heading_deg % 360
        by_direction = by_direction and heading_deg % 360.0 != target_deg
        if not by_direction:
            turn = shorter_turn(heading_deg, target_deg, adoption.half_turn_left)
    if instruction.level_fl is not None:
        higher = instruction.level_fl - fl
        vertical = None if abs(higher) < SAME_FL else "climb" if higher > 0.0 else "descend"
    return replace(instruction, turn=turn, by_direction=by_direction, vertical=vertical)
