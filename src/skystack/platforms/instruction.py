"""One transmission to one aircraft: the one value behind every language.

A platform flies `heading_deg`, `level_fl` and, with `by_direction`, `turn`. The words, `turn` and
`vertical`, are those of the way that is flown: `skystack.platforms.adoption` finds them.
"""

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
    """The way to turn; None where there is nothing to turn, or it is not known yet."""
    by_direction: bool = False
    """Turn that way even where it is the longer one; else always the shorter way."""
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
