"""A what-if search: every flight has a plan to its exit that keeps clear of all other plans.

Trial plans over fixes, headings and levels are flown ahead with the simulator in batches, those
with few transmissions first. A new flight gets the cheapest plan of the first batch in which one is
clear of all other plans; the cost is flying time and transmissions. If no batch has one, flights in
its way are given other plans. If a conflict cannot be avoided, a plan that ends it soon is
accepted. The plans are carried out as they fall due. A planned transmission that would cause a loss
before others can react is withdrawn. Flights that do not hear clearances yet have no plan: for a
minute, they are expected to fly as cleared. (The idea of trial plans is that of AutoResolver:
Erzberger, ICAS 2008.)
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from skystack.agents.probe import (
    AHEAD,
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
from skystack.agents.transmission import PER_CYCLE, Transmission
from skystack.agents.trials import Plan, Trials
from skystack.compilation.fetch import fetched
from skystack.simulator.arrivals import FREE
from skystack.simulator.traffic import DIRECT, SHORTEST
from skystack.tasks.sector_world import World, WorldState

MOVED = 2
"""The maximum number of flights in the way of a flight that are given other plans."""
OTHERS = 32
"""Other flights are padded to a multiple of this number, so that few programs are compiled."""
TWO_BATCHES, THREE_BATCHES = 8, 8
"""The maximum number of batches of plans with two and with three transmissions."""
TRANSMISSION_CYCLES = 30
"""The cost of a transmission, in cycles of flying time."""
NOT_CLEAR = 10_000.0
"""The least cost of a plan with an avoidable conflict or a wrong exit."""
UNAVOIDABLE = 2
"""A loss of separation that begins within this number of cycles under all plans of the first batch
is treated as unavoidable: a clearance takes effect after one cycle, and hardly moves the aircraft
in the next. If another flight comes within the margin that early under all plans, but not closer
than the standard, plans keep only the standard from it, without the margin."""
EXPECTED_CYCLES = 10
"""Flights without a plan are expected to fly as cleared for this number of cycles, the present one
included. They get a plan as soon as they hear clearances."""
SHORT = 10
"""The search ends when a plan has at most this many cycles of unavoidable loss of separation."""
LOSS_CYCLE_COST, MAX_LOSS_CYCLES = 20, 200
"""The cost of a cycle of unavoidable loss of separation, in cycles of flying time, and the number
of cycles from which it does not increase."""


class Search:
    """Implements `skystack.agents.transmission.SectorAgent`.

    `per_cycle` is the maximum number of transmissions in a cycle.
    """

    def __init__(self, world: World, per_cycle: int = PER_CYCLE, seed: int = 0) -> None:
        self.probe, self.per_cycle, self.seed = Probe(world), per_cycle, seed

    def begin(self, state: WorldState) -> None:
        slots = state.traffic.heading_deg.shape[0]
        self._random = np.random.default_rng(self.seed)
        self._cycle = 0
        self._planned = np.full(slots, FREE)
        """The flight for which each slot has a plan."""
        shape = (self.probe.ahead + 1, slots)
        self._position = np.zeros((*shape, 2), dtype=np.float32)
        self._level = np.zeros(shape, dtype=np.float32)
        self._present = np.zeros(shape, dtype=bool)
        """The plans from the present on."""
        self._due: dict[int, list[tuple[int, Transmission]]] = {}
        """The planned transmissions by cycle, each with its flight."""
        self._unsafe: set[int] = set()
        """Slots whose plans are in conflict."""

    def transmit(self, state: WorldState) -> list[Transmission]:
        cycle, flight = int(state.arrivals.cycle), np.asarray(state.arrivals.flight)
        while self._cycle < cycle:
            self._shift()
        gone: Bool[np.ndarray, " slots"] = np.not_equal(self._planned, flight)
        self._present[:, gone] = False
        self._unsafe -= set(np.flatnonzero(gone).tolist())
        self._planned[gone] = FREE
        unplanned = np.flatnonzero((flight != FREE) & (self._planned == FREE))
        ready = unplanned[state.hears[unplanned]].tolist()
        slots = [*ready, *sorted(self._unsafe)]
        if slots and unplanned.tolist() != slots[:1]:  # not if the only one gets its plan first
            self._expect(state, unplanned)
        for slot in slots:
            self._plan(state, slot)
        return [each for number, each in self._due.pop(cycle, []) if flight[each.slot] == number]

    def _shift(self) -> None:
        for values in (self._position, self._level, self._present):
            values[:-1] = values[1:]
        self._present[-1] = False
        self._cycle += 1

    def _expect(self, state: WorldState, slots: Int[np.ndarray, " slots"]) -> None:
        """Expect flights without a plan to fly on as cleared for a while."""
        for begin in range(0, len(slots), PLANS):
            some = slots[begin : begin + PLANS]
            ahead = self._as_cleared(state, some).ahead
            for known, flown in (
                (self._position, ahead.position_nm),
                (self._level, ahead.level_ticks),
                (self._present, ahead.present),
            ):
                known[:, some] = flown[:, : len(some)]
            self._present[EXPECTED_CYCLES:, some] = False

    def _plan(self, state: WorldState, slot: int) -> None:
        """Give a flight a plan.

        Transmissions to others that would soon lead to a loss are withdrawn. If no plan is clear,
        flights in its way get other plans.
        """
        found = self._best(state, slot)
        if withdrawn := [other for other in found.lost if self._is_due(other)]:
            # Their next transmissions may cause the loss, and can still be withdrawn.
            for other in withdrawn:
                self._withdraw(state, other)
            found = self._best(state, slot)
        self._keep(state, slot, found)
        self._unsafe.discard(slot)
        for other in withdrawn:
            if self._plan_again(state, other):
                self._unsafe.discard(other)
            else:
                self._unsafe.add(other)
        if found.is_clear:
            return
        for other in [each for each in found.blockers if self._planned[each] != FREE][:MOVED]:
            if self._plan_again(state, other) and len(found.blockers) == 1:
                return
        self._unsafe.add(slot)

    def _plan_again(self, state: WorldState, slot: int) -> bool:
        """Give a flight another plan if one is clear. Returns whether one is."""
        found = self._best(state, slot)
        if found.is_clear:
            self._keep(state, slot, found)
        return found.is_clear

    def _is_due(self, slot: int) -> bool:
        """Whether a transmission to a flight is planned for the next cycles.

        These are the cycles in which a loss counts as unavoidable.
        """
        soon = range(self._cycle, self._cycle + UNAVOIDABLE + 1)
        return bool(self._planned[slot] != FREE) and any(
            each.slot == slot for cycle in soon for _, each in self._due.get(cycle, [])
        )

    def _withdraw(self, state: WorldState, slot: int) -> None:
        """Replace a flight's plan by one without transmissions."""
        flown, none = self._as_cleared(state, np.array([slot])), np.zeros((1, 0), dtype=np.int32)
        self._keep(state, slot, _better(None, no_events(PLANS), flown, none, none, none[0]))

    def _as_cleared(self, state: WorldState, slots: Int[np.ndarray, " slots"]) -> FlownPlans:
        """At most `PLANS` flights flown ahead as they are cleared; the columns are repeated."""
        rows = flights_in(state, np.resize(slots, PLANS))
        flown: FlownPlans = fetched(self.probe.fly(*rows, no_events(PLANS)))
        return flown

    def _best(self, state: WorldState, slot: int) -> "_Found":
        """The best plan for a flight: without conflicts if possible."""
        numbers = np.flatnonzero(np.any(self._present, axis=0))
        numbers = numbers[numbers != slot]
        missing = max(OTHERS - len(numbers), -len(numbers) % OTHERS)
        padded = np.pad(numbers, (0, missing), constant_values=slot)
        present = self._present[:, padded] & (padded != slot)
        other = Ahead(self._position[:, padded], self._level[:, padded], present)
        rows = flights_in(state, np.full(PLANS, slot))
        best: _Found | None = None
        close: Bool[np.ndarray, " others"] | None = None
        for plans in self._batches(state, slot):
            events = self._events(state, slot, plans)
            flown = fetched(self.probe.fly(*rows, events))
            found = self.probe.conflicts(flown.ahead, other)
            first, loss, cycles = (
                np.array(each)[: len(plans), : len(numbers)]
                for each in (found.first, found.first_loss, found.cycles_of_loss)
            )
            if close is None:
                close = np.all(first <= UNAVOIDABLE, axis=0)
                unavoidable = np.all(loss <= UNAVOIDABLE, axis=0)
            first = np.where(close, loss, first)
            first[:, unavoidable] = NEVER
            lost = np.where(unavoidable, cycles, 0)
            best = _better(best, events, flown, first, lost, numbers)
            if best.cost < NOT_CLEAR and best.loss_cycles <= SHORT:
                break
        assert best is not None
        return best

    def _batches(self, state: WorldState, slot: int) -> Iterator[list[Plan]]:
        """Trial plans, those with the fewest transmissions first."""
        trials = Trials.of(state, slot, self.probe.world, self._random)
        first = list(trials.simple())
        for begin in range(0, len(first), PLANS):
            yield first[begin : begin + PLANS]
        for draw, batches in ((trials.two, TWO_BATCHES), (trials.three, THREE_BATCHES)):
            for _ in range(batches):
                yield [draw() for _ in range(PLANS)]

    def _events(self, state: WorldState, slot: int, plans: list[Plan]) -> Events:
        """Plans as events, at cycles in which the radio is free."""
        events = no_events(PLANS)
        heading = float(state.traffic.heading_deg[slot])
        busy = {cycle for cycle, due in self._due.items() if self._taken(due, slot)}
        for number, plan in enumerate(plans):
            taken: set[int] = set()
            for index, step in enumerate(plan):
                cycle = self._cycle + step.wait
                while cycle in busy or cycle in taken:
                    cycle += 1
                taken.add(cycle)
                transmission = step.transmission(slot, heading)
                set_event(events, number, index, cycle - self._cycle, transmission)
        return events

    def _taken(self, due: list[tuple[int, Transmission]], slot: int) -> bool:
        return sum(each.slot != slot for _, each in due) >= self.per_cycle

    def _keep(self, state: WorldState, slot: int, found: "_Found") -> None:
        """Replace a flight's plan."""
        flight = int(state.arrivals.flight[slot])
        self._planned[slot] = flight
        self._position[:, slot] = found.position_nm
        self._level[:, slot] = found.level_ticks
        self._present[:, slot] = found.present
        for cycle, due in list(self._due.items()):
            self._due[cycle] = [each for each in due if each[1].slot != slot]
        for wait, each in found.transmissions(slot):
            self._due.setdefault(self._cycle + wait, []).append((flight, each))


class _Found(NamedTuple):
    """A plan with its flight ahead."""

    cost: float
    """Below `NOT_CLEAR` if it has a correct exit and no avoidable conflict."""
    blockers: list[int]
    """The slots of the flights with which it has avoidable conflicts, the earliest first."""
    position_nm: Float[np.ndarray, "cycles 2"]
    level_ticks: Float[np.ndarray, " cycles"]
    present: Bool[np.ndarray, " cycles"]
    events: Events
    """Without the axis of plans."""
    loss_cycles: int
    """The number of cycles of unavoidable loss of separation, summed over the other flights."""
    lost: list[int]
    """The slots of the flights with which this loss occurs."""

    @property
    def is_clear(self) -> bool:
        """Whether it has no conflict and ends at the right exit and level."""
        return self.cost < NOT_CLEAR and not self.loss_cycles

    def transmissions(self, slot: int) -> Iterator[tuple[int, Transmission]]:
        events = self.events
        for number in range(EVENTS):
            if events.cycle[number] == NEVER:
                continue
            turn = int(events.turn[number])
            yield (
                int(events.cycle[number]),
                Transmission(
                    slot,
                    int(events.heading_deg[number]) if turn == SHORTEST else None,
                    int(events.fix[number]) if turn == DIRECT else None,
                    float(events.level_ticks[number]) if events.changes_level[number] else None,
                ),
            )


def _better(
    best: _Found | None,
    events: Events,
    flown: FlownPlans,
    first: Int[np.ndarray, "plans others"],
    lost: Int[np.ndarray, "plans others"],
    numbers: Int[np.ndarray, " others"],
) -> _Found:
    """The best of the plans flown and the best so far.

    `first` excludes unavoidable conflicts; `lost` has the number of cycles of unavoidable loss with
    each other flight.
    """
    count, loss_cycles = len(first), lost.sum(axis=1)
    conflicts = (first < NEVER).sum(axis=1)
    soonest = first.min(axis=1, initial=NEVER)
    wrong = ~flown.correct[:count]
    sent = (events.cycle[:count] < NEVER).sum(axis=1)
    cost = (
        TRANSMISSION_CYCLES * sent
        + flown.cycles[:count]
        + LOSS_CYCLE_COST * np.minimum(loss_cycles, MAX_LOSS_CYCLES)
        + NOT_CLEAR * (conflicts > 0)
        + 2_000.0 * conflicts
        - 5.0 * np.minimum(soonest, AHEAD) * (conflicts > 0)
        + 10.0 * NOT_CLEAR * wrong
    )
    number = int(np.argmin(cost))
    if best is not None and best.cost <= cost[number]:
        return best
    order = np.argsort(first[number], kind="stable")
    blockers = [int(numbers[each]) for each in order if first[number, each] < NEVER]
    return _Found(
        float(cost[number]),
        blockers,
        flown.ahead.position_nm[:, number],
        flown.ahead.level_ticks[:, number],
        flown.ahead.present[:, number],
        Events(*(values[number] for values in events)),
        int(loss_cycles[number]),
        numbers[lost[number] > 0].tolist(),
    )
