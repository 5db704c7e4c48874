"""Advice: what to do about the most urgent concern, as a few ranked alternatives.

The concern is the pair of flights that will lose separation first or, if there is none, the
flight that will leave next without a correct exit. Alternatives are trial plans for its flights,
flown ahead by `skystack.live.what_if`, and what the adviser itself would transmit.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Literal, NamedTuple

import numpy as np

from skystack.agents.learned import Certainty, Learned
from skystack.agents.probe import NEVER
from skystack.agents.search import TRANSMISSION_CYCLES
from skystack.agents.transmission import SectorAgent, Transmission
from skystack.agents.trials import Plan, Trials
from skystack.live.what_if import Planned, Trial, WhatIf
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.sector_world import World, WorldState

DRAWN = 64
"""The number of random plans with two transmissions that are tried for a flight."""
ALTERNATIVES = 3
"""The number of alternatives, with that of the adviser."""
PREFERENCE_CYCLES = 60.0
"""How much a kind of clearance gains in the ranking, in cycles of flying time, if all accepted
alternatives were of that kind."""
MARGIN_NM = 0.5
"""Plans that stay this far beyond the separation standard are preferred."""
SAME_HEADING_DEG = 15
"""Headings that differ by at most this much are the same proposal."""
TRIAL = "trial plan"
"""The source of alternatives that the adviser did not propose."""


class Concern(NamedTuple):
    """What calls for a clearance, and what happens if nothing is issued."""

    slots: tuple[int, ...]
    """A pair of flights in conflict, or the flight with the wrong exit."""
    kind: Literal["conflict", "exit"]
    lost_in_s: float | None
    """The time until separation is lost, for a conflict."""
    least_nm: float | None
    """The least distance, for a conflict."""


class Alternative(NamedTuple):
    """A transmission to issue now, and how the flight could continue."""

    trial: Trial
    source: str
    extra_nm: float | None
    """Track miles more than on own navigation from now on, cleared to the exit level; negative for
    fewer. None if the plan or own navigation has no correct exit."""
    level_change_fl: int
    """From the present level to the level cleared now; 0 without one."""
    certainty: Certainty | None = None
    """How certain the adviser is of its own proposal, if it can tell."""
    agrees: bool | None = None
    """Whether the best trial plan for the flight begins with the adviser's proposal; None for trial
    plans."""

    @property
    def transmission(self) -> Transmission:
        return self.trial.plan[0].transmission


def most_urgent(what_if: WhatIf, state: WorldState) -> Concern | None:
    """The most urgent concern among flights that hear; None if there is none."""
    pairs = [
        (each.lost_in_s, (slot, each.slot), each)
        for slot, each in what_if.closest(state)
        if each.lost_in_s is not None and (state.hears[slot] or state.hears[each.slot])
    ]
    if pairs:
        lost_in_s, slots, approach = min(pairs, key=lambda each: each[0])
        return Concern(slots, "conflict", lost_in_s, approach.least_nm)
    flown = what_if.as_cleared(state)
    wrong = state.hears & ~flown.correct
    if not wrong.any():
        return None
    first = int(np.argmin(np.where(wrong, flown.cycles, NEVER)))
    return Concern((first,), "exit", None, None)


class Advice(NamedTuple):
    """Alternatives for a concern, the best first."""

    number: int
    cycle: int
    concern: Concern
    alternatives: list[Alternative]


class Adviser:
    """Finds alternatives. `agent` is asked for its own proposal; it may be None."""

    def __init__(
        self, world: World, what_if: WhatIf, agent: SectorAgent | None, name: str, seed: int = 0
    ) -> None:
        self._world, self._what_if, self._agent, self._name = world, what_if, agent, name
        self._random = np.random.default_rng(seed)

    def proposed(self, state: WorldState) -> list[Transmission]:
        """What the agent would transmit now, asked afresh."""
        if self._agent is None:
            return []
        self._agent.begin(state)
        return self._agent.transmit(state)

    def advise(self, state: WorldState, number: int, chosen: Sequence[str] = ()) -> Advice | None:
        """Advice about the most urgent concern; None if there is none.

        `chosen` are the kinds of clearances that were accepted earlier: the more often, the higher
        such alternatives rank.
        """
        concern = most_urgent(self._what_if, state)
        if concern is None:
            return None
        proposed = self.proposed(state)
        slots = [slot for slot in concern.slots if state.hears[slot]]
        found = [each for slot in slots for each in self._all(state, slot, proposed)]
        cost = partial(self._cost, Counter(chosen))
        by_cost = partial(sorted, key=lambda each: cost(each.trial))
        ranked = by_cost(each for each in found if each.source == TRIAL)
        own = by_cost(each for each in found if each.source != TRIAL)
        own = [each._replace(agrees=_agrees(each, ranked)) for each in own[:1]]
        best = islice(_different([*own, *ranked]), ALTERNATIVES)
        # The agent may rely on what it would also transmit to other flights.
        safest = sorted(best, key=lambda each: each.trial.lost_in_s is not None)
        return Advice(number, int(state.arrivals.cycle), concern, safest)

    def _all(
        self, state: WorldState, slot: int, proposed: list[Transmission]
    ) -> Iterator[Alternative]:
        """What the agent proposes for a flight, and trial plans."""
        next_fix, level = state.progress.next_fix[slot], state.plan.exit_level_ticks[slot]
        own_navigation = Transmission(slot, fix=int(next_fix), level_ticks=float(level))
        now = [each for each in proposed if each.slot == slot]
        plans = [
            *((Planned(0, each),) for each in (own_navigation, *now)),
            *(_planned(state, slot, plan) for plan in dict.fromkeys(self._plans(state, slot))),
        ]
        direct, *trials = self._what_if.trials(state, slot, plans)
        certainty = self._certainty(state, slot) if now else None
        for number, trial in enumerate(trials):
            is_own = number < len(now)
            both_exit = trial.leaves_correctly and direct.leaves_correctly
            yield Alternative(
                trial,
                self._name if is_own else TRIAL,
                trial.flown_nm - direct.flown_nm if both_exit else None,
                _level_change_fl(trial),
                certainty if is_own else None,
            )

    def _certainty(self, state: WorldState, slot: int) -> Certainty | None:
        return self._agent.certainty(state, slot) if isinstance(self._agent, Learned) else None

    def _plans(self, state: WorldState, slot: int) -> Iterator[Plan]:
        """Plans whose first transmission is issued now."""
        found = Trials.of(state, slot, self._world, self._random)
        for plan in found.simple():
            if plan and not plan[0].wait:
                yield plan
        for _ in range(DRAWN):
            first, *later = found.two()
            yield (
                first._replace(wait=0),
                *(each._replace(wait=each.wait - first.wait) for each in later),
            )

    def _cost(self, chosen: Counter[str], trial: Trial) -> tuple[bool, bool, bool, float]:
        """Smaller is better: separation first, then the exit, a margin, then time and words."""
        least_nm = np.inf if trial.least_nm is None else trial.least_nm
        close = least_nm < self._world.sector.separation_nm + MARGIN_NM
        cost = float(len(trial.position_nm) + TRANSMISSION_CYCLES * len(trial.plan))
        if chosen:
            kind = kind_of(trial.plan[0].transmission)
            cost -= PREFERENCE_CYCLES * chosen[kind] / chosen.total()
        return trial.lost_in_s is not None, not trial.leaves_correctly, close, cost


def kind_of(transmission: Transmission) -> Literal["heading", "direct", "level"]:
    """`heading`, `direct` or `level`: the kind of its first element."""
    if transmission.heading_deg is not None:
        return "heading"
    return "level" if transmission.fix is None else "direct"


def _agrees(own: Alternative, ranked: Sequence[Alternative]) -> bool:
    """Whether the best trial plan for a flight begins with the same clearance."""
    transmission = own.transmission
    best = next((e.transmission for e in ranked if e.transmission.slot == transmission.slot), None)
    if best is None or (transmission.fix, transmission.level_ticks) != (best.fix, best.level_ticks):
        return False
    if transmission.heading_deg is None or best.heading_deg is None:
        return transmission.heading_deg is best.heading_deg
    return abs((transmission.heading_deg - best.heading_deg + 180) % 360 - 180) <= SAME_HEADING_DEG


def _level_change_fl(trial: Trial) -> int:
    level = trial.plan[0].transmission.level_ticks
    return 0 if level is None else round(level / TICKS_PER_FL - float(trial.fl[0]))


def _different(ranked: Iterable[Alternative]) -> Iterator[Alternative]:
    """The best alternatives of each kind for each flight."""
    seen: set[tuple[int, str]] = set()
    for each in ranked:
        key = each.transmission.slot, kind_of(each.transmission)
        if key not in seen:
            seen.add(key)
            yield each


def _planned(state: WorldState, slot: int, plan: Plan) -> tuple[Planned, ...]:
    """A trial plan as transmissions."""
    heading_deg = float(state.traffic.heading_deg[slot])
    return tuple(Planned(step.wait, step.transmission(slot, heading_deg)) for step in plan)
