"""One transmission to one aircraft, from which the text in every language is made.

A platform flies `heading_deg`, `level_fl` and, with `by_direction`, `turn`. Otherwise `turn` and
`vertical` are wording only, and state what is flown: `skystack.platforms.adoption` sets them.
"""

from dataclasses import dataclass
from typing import Literal

from skystack.errors import InputError


@dataclass(frozen=True)
class Instruction:
    """A heading or a fix, with or without a level, or a level alone.

    Raises InputError for an invalid combination.
    """

    callsign: str
    heading_deg: int | None = None
    """Whole degrees in [0, 360]; 0 and 360 are the same."""
    turn: Literal["left", "right"] | None = None
    """The direction of the turn; None if there is no turn or its direction is not known yet."""
    by_direction: bool = False
    """Whether to turn in that direction even if it is the longer way; otherwise the shorter."""
    level_fl: int | None = None
    vertical: Literal["climb", "descend"] | None = None
    """The direction of the level change; None if the aircraft is at the level."""
    direct_to: str | None = None
    """The fix of its route to which the aircraft flies, and from there along the route."""

    def __post_init__(self) -> None:
        if self.heading_deg is None and self.level_fl is None and self.direct_to is None:
            raise InputError(
                f"an instruction to {self.callsign} needs heading_deg, direct_to or level_fl"
            )
        if self.heading_deg is not None and self.direct_to is not None:
            raise InputError(f"direct_to is {self.direct_to!r} (allowed: only without heading_deg)")
        if self.heading_deg is not None and not 0 <= self.heading_deg <= 360:
            raise InputError(f"heading_deg is {self.heading_deg} (allowed: 0 to 360)")
        if self.level_fl is not None and self.level_fl < 0:
            raise InputError(f"level_fl is {self.level_fl} (allowed: 0 or more)")
        if self.turn is not None and self.heading_deg is None:
            raise InputError(f"turn is {self.turn!r} (allowed: only together with heading_deg)")
        if self.by_direction and self.turn is None:
            raise InputError("by_direction is true (allowed: only together with turn)")
        if self.vertical is not None and self.level_fl is None:
            raise InputError(
                f"vertical is {self.vertical!r} (allowed: only together with level_fl)"
            )
