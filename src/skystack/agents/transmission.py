"""A transmission to one flight, and the protocol of agents that control a sector."""

from typing import Literal, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from skystack.platforms.instruction import Instruction
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import (
    DIRECT,
    LEFT,
    NO_TURN,
    RIGHT,
    SHORTEST,
    Clearance,
    Traffic,
)
from skystack.tasks.sector_world import WorldState

TURNS = {None: SHORTEST, "left": LEFT, "right": RIGHT}
"""The simulator's kind of turn for each direction."""
PER_CYCLE = 5
"""The default maximum number of transmissions in a cycle."""
MOST_INSTRUCTIONS = 40
"""The maximum number of instructions in a transmission."""


class Transmission(NamedTuple):
    """A heading or a fix, with or without a level, or a level alone, to the flight in a slot."""

    slot: int
    heading_deg: int | None = None
    """Whole degrees in [0, 360)."""
    fix: int | None = None
    """Index in the route of the fix to fly to on own navigation."""
    level_ticks: float | None = None
    instructions: int = 1
    """The number of instructions that were stacked into it."""
    turn: Literal["left", "right"] | None = None
    """The direction of the turn to `heading_deg`; None for the shorter turn."""


@runtime_checkable
class SectorAgent(Protocol):
    """A controller of a sector."""

    def begin(self, state: WorldState) -> None:
        """Forget everything: a new scenario begins."""

    def transmit(self, state: WorldState) -> list[Transmission]:
        """The transmissions before the next cycle; the arrays of the state are numpy arrays."""


def instruction_of(
    transmission: Transmission, callsign: str, route: tuple[str, ...]
) -> Instruction:
    """A transmission to the flight with a callsign and a route, as platforms receive it."""
    fix, level = transmission.fix, transmission.level_ticks
    return Instruction(
        callsign,
        heading_deg=transmission.heading_deg,
        turn=transmission.turn,
        by_direction=transmission.turn is not None,
        direct_to=None if fix is None else route[fix],
        level_fl=None if level is None else round(level / TICKS_PER_FL),
    )


def clearance_of(transmissions: list[Transmission], slots: int) -> Clearance:
    """Transmissions to different flights as one clearance of the simulator."""
    turn, fix = np.full(slots, NO_TURN, dtype=np.int32), np.zeros(slots, dtype=np.int32)
    heading, level = np.zeros((2, slots), dtype=np.float32)
    changes = np.zeros(slots, dtype=bool)
    for each in transmissions:
        if each.heading_deg is not None:
            turn[each.slot], heading[each.slot] = TURNS[each.turn], each.heading_deg
        if each.fix is not None:
            turn[each.slot], fix[each.slot] = DIRECT, each.fix
        if each.level_ticks is not None:
            changes[each.slot], level[each.slot] = True, each.level_ticks
    return Clearance(*map(jnp.asarray, (turn, heading, changes, level, fix)))


def transmission_between(
    before: Traffic, after: Traffic, slot: int, instructions: int
) -> Transmission | None:
    """The transmission that combines all instructions to a flight; None if nothing changes.

    `before` and `after` are the traffic before and after the instructions.
    """
    turn = int(after.pending_turn[slot])
    fix = heading = level = None
    if turn == DIRECT and after.cleared_fix is not None:
        fix = int(after.cleared_fix[slot])
    elif turn != NO_TURN:
        heading = _whole_heading(after, slot)
        if heading == _whole_heading(before, slot) and not bool(before.own_navigation[slot]):
            heading = None  # turned back to where it was
    if float(after.cleared_level_ticks[slot]) != float(before.cleared_level_ticks[slot]):
        level = float(after.cleared_level_ticks[slot])
    if heading is None and fix is None and level is None:
        return None
    return Transmission(slot, heading, fix, level, instructions)


def _whole_heading(traffic: Traffic, slot: int) -> int:
    return int(np.round(float(traffic.cleared_heading_deg[slot]))) % 360
