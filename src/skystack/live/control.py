"""A live session as a state machine: what a person or an adviser does, one call at a time.

It does not depend on servers or pages. Only `step` and `restore` advance simulated time; `rewind`
takes it back.
"""

from collections.abc import Iterable
from copy import copy
from pathlib import Path
from typing import Any

from skystack.agents.probe import Probe
from skystack.agents.search import Search
from skystack.agents.transmission import Transmission
from skystack.compilation.memory import return_freed_memory
from skystack.errors import InputError, unknown_name
from skystack.live.advice import Advice, Adviser, Alternative, kind_of
from skystack.live.advice_log import AdviceAnswered, AdviceLog, AdviceShown, Shown
from skystack.live.clearance_text import parse_clearance
from skystack.live.history import History
from skystack.live.hour import LEVEL_STEP_FL
from skystack.live.journal import ClearanceIssued, CycleFlown, Entry, HandedOver, Journal, WentBack
from skystack.live.recorded import LiveSession
from skystack.live.views import Views, rounded
from skystack.live.what_if import Planned, WhatIf
from skystack.platforms.instruction import Instruction
from skystack.platforms.phraseology import read_back, written
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import ticks

YOU = "you"
VALID_CYCLES = 5
"""The number of cycles for which advice can be accepted, unless a clearance is issued first."""


class LiveControl:
    """A session: its traffic, its history, and who controls which flight."""

    def __init__(
        self,
        opened: LiveSession,
        cycles: int,
        adviser: str | None = None,
        journal: Journal | None = None,
        out: Path | None = None,
    ) -> None:
        """`cycles` is the length of the session; `adviser` is the name of `opened.adviser`.

        With a journal, a history that is left by going back is first written to a folder in `out`.
        """
        self.opened, self.hour, self.cycles, self.adviser = opened, opened.hour, cycles, adviser
        self.playing, self.speed = False, 1
        self.handed: set[str] = set()
        """The callsigns that the adviser controls."""
        self.hands_all = False
        """Whether the adviser controls all flights, also those to come."""
        self.advice: Advice | None = None
        """The last advice, until another clearance is issued or the session goes back."""
        self.shown: dict[str, Any] = {}
        """What pages show of it, described when it was given: its flights may leave."""
        self.log = AdviceLog()
        self.branches: list[Path] = []
        """The folders of the histories that were left."""
        self._left = 0
        self._journal, self._out = journal, out
        world = self.hour.world
        self.history = History(world.simulator)
        self.history.add_start(self.hour.state, self.hour.slots)
        agent = opened.adviser
        self._what_if = WhatIf(agent.probe if isinstance(agent, Search) else Probe(world))
        self._adviser = Adviser(world, self._what_if, agent, adviser or "")
        self._delegate = copy(agent)  # its plans are not those of the adviser, who is asked afresh
        self._begun = False
        self.views = Views(self.hour, self._what_if)

    @property
    def cycle(self) -> int:
        """The number of cycles flown."""
        return self.hour.cycle

    @property
    def ended(self) -> bool:
        return self.cycle >= self.cycles

    def compile(self) -> None:
        """Compile the programs of cycles, trials and the adviser now, not during the session.

        An adviser may compile more when there are flights.
        """
        return_freed_memory()  # opening the session has already compiled programs
        self.hour.compile()
        return_freed_memory()
        self._what_if.compile(self.hour.state)
        if self._delegate is not None:
            self._delegate.begin(self.hour.state)
            self._delegate.transmit(self.hour.state)
        return_freed_memory()

    def restore(self, entries: Iterable[Entry]) -> None:
        """Fly the entries of a journal again.

        Without an adviser, flights that were handed over are taken back. Raises InputError if an
        entry does not fit this session.
        """
        journal, self._journal = self._journal, None
        for entry in entries:
            if isinstance(entry, WentBack):
                self.rewind(entry.cycle)
            elif isinstance(entry, CycleFlown):
                self._check_number(entry)
                self._advance()
            elif isinstance(entry, HandedOver):
                self._hand_over(entry)
            elif isinstance(entry, AdviceShown | AdviceAnswered):
                self.log.add(entry)
            else:
                self._transmit(self._transmission(entry), entry.by)
        self._journal = journal
        if self._delegate is None and (self.hands_all or self.handed):
            self._hand_over(HandedOver([], to_adviser=False))

    def _check_number(self, entry: CycleFlown) -> None:
        if entry.number != self.cycle + 1:
            found = f"cycle {entry.number} after cycle {self.cycle}"
            raise _does_not_fit(found, str(self.cycle + 1))

    def step(self) -> None:
        """Fly one cycle, after the adviser has instructed its flights."""
        if self.ended:
            raise InputError(
                f"the session has ended after {self.cycles} cycles (allowed: a larger --cycles)"
            )
        for each in self._delegated():
            self._transmit(each, self.adviser or "")
        self._advance()
        if self.ended:
            self.playing = False

    def clear(self, text: str, modifies: tuple[int, int] | None = None) -> str:
        """Issue the clearance of a text; returns what the pilot reads back.

        `modifies` are the number and the rank of an alternative that it changes. Raises InputError
        if it is not understood or cannot be flown.
        """
        if modifies is not None and not self.log.has(*modifies):
            raise InputError("there is no such advice (allowed: what was shown)")
        transmission = self.hour.transmission_for(parse_clearance(text, self.hour.slots))
        issued = self._transmit(transmission, YOU)
        if modifies is not None:
            number, rank = modifies
            self._note(AdviceAnswered(number, rank, "modified", written(issued)))
        self._begun = False  # the adviser's plans did not include this clearance
        return read_back(issued)

    def trial(self, text: str) -> dict[str, Any]:
        """What a clearance would lead to; nothing is issued. Raises InputError as `clear` does."""
        transmission = self.hour.transmission_for(parse_clearance(text, self.hour.slots))
        (trial,) = self._what_if.trials(
            self.hour.state, transmission.slot, [(Planned(0, transmission),)]
        )
        return self.views.trial(trial)

    def choices(self, callsign: str) -> dict[str, Any]:
        """The `fixes` ahead of a flight, and what a clearance to each of the `levels` leads to.

        Raises InputError for an unknown callsign.
        """
        if callsign not in self.hour.slots:
            raise unknown_name("callsign", callsign, self.hour.slots)
        slot = self.hour.slots[callsign]
        lowest, highest = self.hour.world.sector.levels_fl
        levels_fl = range(lowest, highest + 1, LEVEL_STEP_FL)
        cleared = (Transmission(slot, level_ticks=ticks(float(fl))) for fl in levels_fl)
        plans = [(Planned(0, each),) for each in cleared]
        trials = self._what_if.trials(self.hour.state, slot, plans)
        return {
            "fixes": self.hour.fixes_ahead(slot),
            "levels": [
                {"fl": fl, "lost_in_s": each.lost_in_s, "least_nm": rounded(each.least_nm)}
                for fl, each in zip(levels_fl, trials, strict=True)
            ],
        }

    def advise(self, conforms: bool = False) -> Advice | None:
        """Advice about the most urgent concern; None if there is none.

        With `conforms`, kinds of clearances that were accepted more often rank higher.
        """
        chosen = self.log.chosen() if conforms else ()
        self.advice = self._adviser.advise(self.hour.state, len(self.log), chosen)
        if self.advice is not None:
            self.shown = self.views.advice(self.advice, self.advice.cycle + VALID_CYCLES)
            self._note(_logged(self.advice, self.shown))
        return self.advice

    def accept(self, number: int, rank: int) -> str:
        """Issue an alternative of the last advice; returns what the pilot reads back.

        The effects shown were predicted when the advice was given, and may have changed. Raises
        InputError if the advice is out of date.
        """
        chosen = self._shown(number, rank)
        self._begun = False
        issued = self._transmit(chosen.transmission, YOU)
        self._note(AdviceAnswered(number, rank, "accepted"))
        return read_back(issued)

    def refuse(self, number: int, rank: int) -> None:
        """Record that an alternative was refused. Raises InputError if there is no such advice."""
        self._shown(number, rank)
        self._note(AdviceAnswered(number, rank, "refused"))

    def _shown(self, number: int, rank: int) -> Alternative:
        """An alternative of the last advice, if that is valid and its flight is still there."""
        advice = self.advice
        if advice is not None and advice.number == number and rank < len(advice.alternatives):
            alternative = advice.alternatives[rank]
            callsign = self.shown["alternatives"][rank]["callsign"]
            is_there = self.hour.slots.get(callsign) == alternative.transmission.slot
            is_valid = self.cycle <= self.shown["until_cycle"]
            if is_there and is_valid and self.hour.can_fly(alternative.transmission):
                return alternative
        raise InputError("this advice is out of date (allowed: ask again)")

    def _note(self, entry: AdviceShown | AdviceAnswered) -> None:
        self.log.add(entry)
        self._write(entry)

    def hand_over(self, callsigns: list[str], to_adviser: bool) -> None:
        """Hand flights over to the adviser, or take them back; an empty list means all.

        Raises InputError without an adviser, or for an unknown callsign.
        """
        if self._delegate is None:
            raise InputError("there is no adviser (allowed: start the session with --adviser)")
        for each in callsigns:
            if each not in self.hour.slots:
                raise unknown_name("callsign", each, self.hour.slots)
        self._hand_over(HandedOver(callsigns, to_adviser))

    def _hand_over(self, entry: HandedOver) -> None:
        self._write(entry)
        self._begun = False
        if not entry.callsigns:
            self.hands_all, self.handed = entry.to_adviser, set()
        elif entry.to_adviser:
            self.handed |= set(entry.callsigns) & self.hour.slots.keys()
        else:
            if self.hands_all:
                self.hands_all, self.handed = False, set(self.hour.slots)
            self.handed -= set(entry.callsigns)

    def rewind(self, cycle: int) -> None:
        """Go back to the end of a cycle. Raises InputError if it has not been flown."""
        if cycle < self.cycle:
            left = self._left + 1
            if self._out is not None and self._journal is not None:
                self.branches.append(self.opened.write(self._out, left)[0])
            self._left = left
        self.hour.rewind(cycle)
        self.history.rewind(cycle)
        self.playing, self._begun, self.advice = False, False, None
        self._write(WentBack(cycle))

    def status(self) -> dict[str, Any]:
        """What pages show besides the history."""
        state = self.hour.state
        return {
            "cycle": self.cycle,
            "cycles": self.cycles,
            "playing": self.playing,
            "speed": self.speed,
            "adviser": self.adviser,
            "hands_all": self.hands_all,
            "handed": sorted(self.handed & self.hour.slots.keys()),
            "not_on_frequency": [
                name for name, slot in self.hour.slots.items() if not state.hears[slot]
            ],
            "waiting": int(state.arrivals.waiting),
        }

    def _advance(self) -> None:
        self._write(CycleFlown(self.cycle + 1))  # first: if it fails, nothing has happened
        cycle = self.hour.advance()
        self.history.add_cycle(self.cycle, cycle, self.hour.slots)
        self.handed &= self.hour.slots.keys()

    def _transmit(self, transmission: Transmission, by: str) -> Instruction:
        """Issue a transmission; no time passes."""
        self._write(
            ClearanceIssued(
                callsign=self.hour.callsigns[transmission.slot],
                by=by,
                heading_deg=transmission.heading_deg,
                turn=transmission.turn,
                fix=transmission.fix,
                level_ticks=transmission.level_ticks,
                instructions=transmission.instructions,
            )
        )
        issued = self.hour.transmit(transmission)
        self.advice = None  # it did not know of this clearance
        self.history.add_clearance(self.hour.state, transmission, issued, by)
        return issued

    def _delegated(self) -> list[Transmission]:
        """What the adviser transmits to the flights that were handed over."""
        if self._delegate is None or not (self.hands_all or self.handed):
            return []
        if not self._begun:
            self._delegate.begin(self.hour.state)
            self._begun = True
        name = self.hour.callsigns
        return [
            each
            for each in self._delegate.transmit(self.hour.state)
            if self.hands_all or name[each.slot] in self.handed
        ]

    def _transmission(self, entry: ClearanceIssued) -> Transmission:
        if entry.callsign not in self.hour.slots:
            found = f"a clearance to {entry.callsign} in cycle {self.cycle}"
            raise _does_not_fit(f"{found}, but there is no such flight", "the same traffic")
        slot = self.hour.slots[entry.callsign]
        route = self.hour.world.sector.routes[int(self.hour.state.traffic.route[slot])]
        if entry.fix is not None and entry.fix >= len(route):
            raise _does_not_fit(f"fix {entry.fix} for {entry.callsign}", f"0 to {len(route) - 1}")
        self._check_level(entry)
        turn: Any = entry.turn
        return Transmission(
            slot, entry.heading_deg, entry.fix, entry.level_ticks, entry.instructions, turn
        )

    def _check_level(self, entry: ClearanceIssued) -> None:
        if entry.level_ticks is None:
            return
        level_fl = entry.level_ticks / TICKS_PER_FL
        lowest, highest = self.hour.world.sector.levels_fl
        if not lowest <= level_fl <= highest:
            found = f"FL{level_fl:.0f} for {entry.callsign}"
            raise _does_not_fit(found, f"FL{lowest} to FL{highest}")

    def _write(self, entry: Entry) -> None:
        if self._journal is not None:
            self._journal.add(entry)


def _does_not_fit(found: str, allowed: str) -> InputError:
    return InputError(f"the journal has {found} (allowed: {allowed}; --new begins another session)")


def _logged(advice: Advice, shown: dict[str, Any]) -> AdviceShown:
    """Advice as the log has it; `shown` is what pages show of it."""
    return AdviceShown(
        number=advice.number,
        cycle=advice.cycle,
        concern=advice.concern.kind,
        flights=shown["callsigns"],
        alternatives=[
            Shown(
                source=each.source,
                kind=kind_of(each.transmission),
                text=view["words"],
                least_nm=view["least_nm"],
                extra_nm=view["extra_nm"],
            )
            for each, view in zip(advice.alternatives, shown["alternatives"], strict=True)
        ],
    )
