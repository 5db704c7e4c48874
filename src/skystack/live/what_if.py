"""What would happen: flights flown ahead under trial clearances, and how close they come to others.

Everything is flown with the simulator itself, so turns and routes are exact; climbs are flown at
nominal rates. Other flights fly as they are cleared; flights that have not arrived yet are unknown.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from skystack.agents.probe import (
    EVENTS,
    NEVER,
    PLANS,
    Ahead,
    Events,
    FlownPlans,
    Probe,
    flights_in,
    no_events,
    set_event,
)
from skystack.agents.transmission import Transmission
from skystack.compilation.fetch import fetched
from skystack.errors import InputError
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.tasks.sector_world import WorldState

HORIZON_CYCLES = 180
"""Close approaches are reported up to 18 minutes ahead."""
REPORTED_NM = 15.0
"""Approaches beyond this distance are not reported."""


class Planned(NamedTuple):
    """A transmission that is issued after some cycles."""

    wait: int
    transmission: Transmission


class CloseApproach(NamedTuple):
    """How close a flight comes to another one without vertical separation."""

    slot: int
    """The other flight's."""
    least_nm: float
    in_s: float
    """The time of the least distance."""
    lost_in_s: float | None
    """The time at which separation is lost, if it is."""


class Trial(NamedTuple):
    """A flight flown ahead under a plan."""

    plan: tuple[Planned, ...]
    position_nm: Float[np.ndarray, "cycles 2"]
    """After each cycle until the flight leaves; the first row is the present."""
    fl: Float[np.ndarray, " cycles"]
    leaves_correctly: bool
    approaches: list[CloseApproach]
    """The closest first, at most `HORIZON_CYCLES` ahead and within `REPORTED_NM`."""

    @property
    def least_nm(self) -> float | None:
        """The least distance to any other flight, if it is within `REPORTED_NM`."""
        return self.approaches[0].least_nm if self.approaches else None

    @property
    def lost_in_s(self) -> float | None:
        """The time until separation is first lost, if it is."""
        return min((a.lost_in_s for a in self.approaches if a.lost_in_s is not None), default=None)

    @property
    def flown_nm(self) -> float:
        """The length of the path in the plane, which is close to the true one."""
        return float(np.linalg.norm(np.diff(self.position_nm, axis=0), axis=1).sum())


class WhatIf:
    """Flies trials in a world. Its programs are compiled on first use."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._of: WorldState | None = None
        self._known: FlownPlans | None = None

    def compile(self, state: WorldState) -> None:
        """Compile all programs now instead of on first use."""
        flown = self._fly(state, np.zeros(PLANS, dtype=np.int64), no_events(PLANS))
        self._approaches(flown.ahead, self.as_cleared(state).ahead)

    def as_cleared(self, state: WorldState) -> FlownPlans:
        """All flights as they are cleared: numpy arrays with one column per slot."""
        if self._of is not state or self._known is None:
            slots = len(state.arrivals.flight)
            shape = (self._probe.ahead + 1, slots)
            ahead = Ahead(
                np.zeros((*shape, 2), dtype=np.float32),
                np.zeros(shape, dtype=np.float32),
                np.zeros(shape, dtype=bool),
            )
            correct, cycles = np.zeros(slots, dtype=bool), np.zeros(slots, dtype=np.int32)
            for rows in _batches(state):
                flown = self._fly(state, rows, no_events(PLANS))
                for values, found in zip(ahead, flown.ahead, strict=True):
                    values[:, rows] = found
                correct[rows], cycles[rows] = flown.correct, flown.cycles
            self._of, self._known = state, FlownPlans(ahead, correct, cycles)
        return self._known

    def closest(self, state: WorldState) -> list[tuple[int, CloseApproach]]:
        """The close approaches of all pairs as cleared, each once, with the first flight's slot."""
        ahead = self.as_cleared(state).ahead
        found: dict[int, list[CloseApproach]] = {}
        for rows in _batches(state):
            mine = Ahead(*(values[:, rows] for values in ahead))
            found |= dict(zip(rows.tolist(), self._approaches(mine, ahead), strict=True))
        return [
            (slot, each) for slot, others in found.items() for each in others if each.slot > slot
        ]

    def trials(
        self, state: WorldState, slot: int, plans: Sequence[tuple[Planned, ...]]
    ) -> list[Trial]:
        """Fly a flight ahead under each plan. Raises InputError for too long a plan."""
        others = self.as_cleared(state).ahead
        present = np.array(others.present)
        present[:, slot] = False
        others = others._replace(present=present)
        found: list[Trial] = []
        for begin in range(0, len(plans), PLANS):
            batch = plans[begin : begin + PLANS]
            flown = self._fly(state, np.full(PLANS, slot), _events(batch))
            close = self._approaches(flown.ahead, others)
            found += [
                _trial(plan, flown, number, close[number]) for number, plan in enumerate(batch)
            ]
        return found

    def _fly(self, state: WorldState, rows: np.ndarray, events: Events) -> Any:
        """Fly the flights in some slots ahead, as `FlownPlans` of numpy arrays."""
        return fetched(self._probe.fly(*flights_in(state, rows), events))

    def _approaches(self, mine: Ahead, others: Ahead) -> list[list[CloseApproach]]:
        """The approaches of each of some flights to others, the closest first."""
        mine = Ahead(*(values[: HORIZON_CYCLES + 1] for values in mine))
        others = Ahead(*(values[: HORIZON_CYCLES + 1] for values in others))
        found = fetched(self._probe.conflicts(mine, others))
        least_nm = np.sqrt(found.least_squared)
        close: Bool[np.ndarray, "mine others"] = least_nm < REPORTED_NM
        return [
            sorted(
                (
                    CloseApproach(
                        slot=int(other),
                        least_nm=float(least_nm[row, other]),
                        in_s=float(found.least_cycle[row, other] * CYCLE_S),
                        lost_in_s=_seconds(int(found.first_loss[row, other])),
                    )
                    for other in np.flatnonzero(close[row])
                ),
                key=lambda each: each.least_nm,
            )
            for row in range(len(close))
        ]


def _batches(state: WorldState) -> list[Int[np.ndarray, " rows"]]:
    """The slots of all flights in batches of `PLANS`; the last batch repeats one of them."""
    slots = np.flatnonzero(state.arrivals.flight != FREE)
    if not len(slots):
        return []
    padded = np.pad(slots, (0, -len(slots) % PLANS), mode="edge")
    return list(padded.reshape(-1, PLANS))


def _seconds(cycle: int) -> float | None:
    return None if cycle == NEVER else float(cycle * CYCLE_S)


def _trial(
    plan: tuple[Planned, ...], flown: Any, number: int, approaches: list[CloseApproach]
) -> Trial:
    cycles = int(flown.ahead.present[:, number].sum())
    return Trial(
        plan=plan,
        position_nm=flown.ahead.position_nm[:cycles, number],
        fl=flown.ahead.level_ticks[:cycles, number] / TICKS_PER_FL,
        leaves_correctly=bool(flown.correct[number]),
        approaches=approaches,
    )


def _events(plans: Sequence[tuple[Planned, ...]]) -> Events:
    """Plans as events of the probe."""
    events = no_events(PLANS)
    for number, plan in enumerate(plans):
        if len(plan) > EVENTS:
            raise InputError(f"a plan of {len(plan)} transmissions (allowed: at most {EVENTS})")
        for index, (wait, transmission) in enumerate(plan):
            set_event(events, number, index, wait, transmission)
    return events
