"""When each platform adopts a clearance, which way it then turns, and the wording for it.

A clearance is issued before a cycle is flown. Skystack and BluebirdDT fly that cycle under the
previous clearance and adopt the new one at its end; BlueSky adopts it at once. The wording states
the direction that is flown after adoption, which may differ from the one at the time of issue.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from skystack.platforms.instruction import Instruction
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import TURN_RATE_DEG_S, turn_to_deg

TurnRule = Callable[
    [Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    Float[np.ndarray, " n"],
]
"""The turn [deg], positive to the right, from actual headings to cleared ones in [0, 360)."""


@dataclass(frozen=True)
class Adoption:
    """How a platform adopts clearances."""

    cycles: int
    """The number of cycles that are still flown under the previous clearance: 1 or 0."""
    shorter_turn_deg: TurnRule
    """The turn flown without a given direction. Half turns follow the platform's own rule."""
    snap_deg: float = 0.0
    """Within this angle of its target, a turn is flown the shorter way even by direction."""


def _turn_in_float32(
    actual_deg: Float[np.ndarray, " n"], cleared_deg: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """The simulator's own rule in its own precision, so that both round alike."""
    headings = (np.asarray(each, dtype=np.float32) for each in (actual_deg, cleared_deg))
    return turn_to_deg(*headings).astype(np.float64)


def _half_turns_avoid_north(
    actual_deg: Float[np.ndarray, " n"], cleared_deg: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """A half turn does not pass through north."""
    turn = cleared_deg - actual_deg
    return np.where(np.abs(turn) > 180.0, turn - np.copysign(360.0, turn), turn)


def _half_turns_left(
    actual_deg: Float[np.ndarray, " n"], cleared_deg: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    return (cleared_deg - actual_deg + 180.0) % 360.0 - 180.0


SKYSTACK = Adoption(1, _turn_in_float32)
BLUEBIRD = Adoption(1, _half_turns_avoid_north, snap_deg=TURN_RATE_DEG_S)
"""BluebirdDT snaps to a heading that it can reach within one second (`docs/platforms.md`)."""
BLUESKY = Adoption(0, _half_turns_left)


def in_words(
    commands: Sequence[Instruction],
    heading_deg: Float[np.ndarray, " commands"],
    fl: Float[np.ndarray, " commands"],
    adoption: Adoption,
) -> list[Instruction]:
    """The commands with the wording of what is flown, from the aircraft's state at adoption.

    `heading_deg` and `fl` are those of the row before the cycle if the platform adopts at once, and
    of the row after it if it adopts at the end. A level counts as reached within a tick.
    """
    cleared_deg = np.array([(command.heading_deg or 0) % 360 for command in commands], dtype=float)
    turns = adoption.shorter_turn_deg(np.asarray(heading_deg), cleared_deg).tolist()
    ticks = np.rint(np.asarray(fl, dtype=np.float64) * TICKS_PER_FL).tolist()
    return [
        _in_words(command, turn, level, adoption.snap_deg)
        for command, turn, level in zip(commands, turns, ticks, strict=True)
    ]


def _in_words(command: Instruction, turn_deg: float, ticks: float, snap_deg: float) -> Instruction:
    turn: Literal["left", "right"] | None = None
    if command.heading_deg is not None and turn_deg != 0.0:
        obeyed = command.by_direction and abs(turn_deg) > snap_deg
        turn = command.turn if obeyed else ("right" if turn_deg > 0.0 else "left")
    vertical: Literal["climb", "descend"] | None = None
    if command.level_fl is not None and command.level_fl * TICKS_PER_FL != ticks:
        vertical = "climb" if command.level_fl * TICKS_PER_FL > ticks else "descend"
    by_direction = command.by_direction and turn == command.turn
    return replace(command, turn=turn, by_direction=by_direction, vertical=vertical)
