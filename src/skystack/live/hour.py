"""An hour of traffic that is flown live: clearances are issued one by one, between cycles.

    hour = LiveHour(world, seed=0)
    hour.issue("AC1 turn left heading 240, climb FL340")   no time passes
    hour.advance()                                         one radar cycle

Everything is recorded, as in an evaluation.
"""

from functools import cached_property
from typing import Any

import numpy as np

from skystack.agents.callsigns import Callsigns
from skystack.agents.transmission import Transmission, instruction_of
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.errors import InputError
from skystack.evaluation.hours import Hour, HourRecorder, Hours, OwnHours, copied, is_fail_safe
from skystack.live.clearance_text import ParsedClearance, parse_clearance
from skystack.platforms.adoption import SKYSTACK, in_words
from skystack.platforms.instruction import Instruction
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World, WorldCycle, WorldState

LEVEL_STEP_FL = 10
"""Flight levels are cleared in multiples of this number."""


class LiveHour:
    """The traffic of one hour, in our simulator or another one, and what has been transmitted."""

    def __init__(
        self, world: World, seed: int = 0, number: int = 0, hours: Hours | None = None
    ) -> None:
        """Begin hour `number` of an evaluation seed, in our simulator unless `hours` are given."""
        self.world, self._seed, self._number = world, seed, number
        self._own = OwnHours(world)
        self._hours = self._own if hours is None or isinstance(hours, OwnHours) else hours
        self._recorder, self._callsigns = HourRecorder(number), Callsigns(world.flow.callsigns)
        self._states = [copied(self._hours.reset(seed, number))]
        """The states after each cycle, before transmissions; the first is the start."""
        self._pending: list[Transmission] = []
        """What has been transmitted since the last cycle."""
        self.state = self._states[0]
        """The last state, with what has been transmitted since."""
        self.slots = self._callsigns.follow(self.state)
        """The slots of all flights, by callsign."""

    def compile(self) -> None:
        """Compile the programs now instead of on first use."""
        fetched(self._own.instruct(self.state, []))
        fetched(self._fail_safe(self.state))
        if self._hours is self._own:
            self._own.advance(self.state, [])

    @property
    def cycle(self) -> int:
        """The number of cycles flown."""
        return int(self.state.arrivals.cycle)

    @property
    def start(self) -> WorldState:
        """The state at cycle 0."""
        return self._states[0]

    def issue(self, text: str) -> Instruction:
        """Issue the clearance of a text; no time passes.

        Returns it with the wording of what will be flown. Raises InputError if it is not understood
        or cannot be flown; nothing is then issued.
        """
        parsed = parse_clearance(text, self.slots)
        return self.transmit(self.transmission_for(parsed))

    def transmit(self, transmission: Transmission) -> Instruction:
        """Issue a transmission to a flight that hears; no time passes."""
        self._recorder.record_transmissions(self.state, [transmission])
        self.state = fetched(self._own.instruct(self.state, [transmission]))
        self._pending.append(transmission)
        return self.phrased(transmission)

    def advance(self) -> WorldCycle:
        """Fly one cycle. Raises PlatformError if another simulator fails."""
        state, cycle = self._hours.advance(self._states[-1], self._pending)
        self.state = self._kept(state)
        self._pending = []
        self._recorder.record_cycle(state, cycle, bool(self._fail_safe(state)))
        self._states.append(self.state)
        self.slots = self._callsigns.follow(self.state)
        return cycle

    def _kept(self, state: WorldState) -> WorldState:
        """A copy of a state that shares with the first state what never changes."""
        first, kept = self._states[0].arrivals, copied(state)
        arrivals = kept.arrivals._replace(candidates=first.candidates, uniforms=first.uniforms)
        return kept._replace(arrivals=arrivals)

    def rewind(self, cycle: int) -> None:
        """Go back to the end of a cycle; what came after is forgotten.

        Another simulator flies the hour again up to this cycle. Raises InputError if the cycle has
        not been flown, and PlatformError if that simulator fails.
        """
        if not 0 <= cycle <= self.cycle:
            raise InputError(f"cycle {cycle} (allowed: 0 to {self.cycle}, the last one flown)")
        del self._states[cycle + 1 :]
        self._recorder.forget_after(cycle)
        self._callsigns = Callsigns(self.world.flow.callsigns)
        for state in self._states:
            self.slots = self._callsigns.follow(state)
        self.state, self._pending = self._states[-1], []
        if self._hours is not self._own:
            self._fly_again()

    def _fly_again(self) -> None:
        """Bring another simulator, which cannot go back, to the last state."""
        state = self._hours.reset(self._seed, self._number)
        for cycle in range(self.cycle):
            sent = [each.transmission for each in self._recorder.sent if each.cycle == cycle]
            state, _ = self._hours.advance(state, sent)

    def close(self) -> None:
        """Release the simulator."""
        self._hours.close()

    def recorded(self) -> Hour:
        """What has been flown so far; at least one cycle."""
        return self._recorder.hour()

    @property
    def callsigns(self) -> dict[int, str]:
        """The callsigns of all flights, by slot."""
        return {slot: callsign for callsign, slot in self.slots.items()}

    @cached_property
    def _fail_safe(self) -> Any:
        return shared_program(is_fail_safe, self.world)

    def transmission_for(self, parsed: ParsedClearance) -> Transmission:
        """A clearance as a transmission. Raises InputError if the flight cannot fly it."""
        slot = self.slots[parsed.callsign]
        if not self.state.hears[slot]:
            raise InputError(
                f"{parsed.callsign} is not on frequency yet (allowed: one or two cycles later)"
            )
        return Transmission(
            slot,
            heading_deg=self._heading(parsed, slot),
            fix=self._fix(parsed, slot),
            level_ticks=self._level(parsed, slot),
            turn=None if parsed.by_deg is not None else parsed.turn,
        )

    def _heading(self, parsed: ParsedClearance, slot: int) -> int | None:
        """Degrees in [0, 360). A turn by degrees is from the present heading."""
        if parsed.by_deg is not None:
            present = round(float(self.state.traffic.heading_deg[slot]))
            return (present + parsed.by_deg * (-1 if parsed.turn == "left" else 1)) % 360
        return None if parsed.heading_deg is None else parsed.heading_deg % 360

    def _fix(self, parsed: ParsedClearance, slot: int) -> int | None:
        """The index in the route of the fix to fly to."""
        if not parsed.own_navigation:
            return None
        following = int(self.state.progress.next_fix[slot])
        ahead = self.fixes_ahead(slot)
        if parsed.direct_to is None:
            return following
        if parsed.direct_to not in ahead:
            raise InputError(
                f"{parsed.callsign} direct {parsed.direct_to} (allowed: {', '.join(ahead)})"
            )
        return following + ahead.index(parsed.direct_to)

    def can_fly(self, transmission: Transmission) -> bool:
        """Whether the flight hears, and has not passed the fix that it would be cleared to."""
        slot, fix = transmission.slot, transmission.fix
        is_ahead = fix is None or fix >= int(self.state.progress.next_fix[slot])
        return bool(self.state.hears[slot]) and is_ahead

    def fixes_ahead(self, slot: int) -> tuple[str, ...]:
        """The fixes of a flight's route from the next one on."""
        return self._route(slot)[int(self.state.progress.next_fix[slot]) :]

    def _level(self, parsed: ParsedClearance, slot: int) -> float | None:
        if parsed.level_fl is None:
            return None
        lowest, highest = self.world.sector.levels_fl
        wanted = parsed.level_fl
        if wanted % LEVEL_STEP_FL or not lowest <= wanted <= highest:
            raise InputError(
                f"{parsed.callsign} to FL{wanted} (allowed: FL{lowest} to FL{highest}, in steps of "
                f"{LEVEL_STEP_FL})"
            )
        level = float(self.state.traffic.level_ticks[slot]) / TICKS_PER_FL
        if parsed.vertical is not None and (wanted > level) != (parsed.vertical == "climb"):
            raise InputError(
                f"{parsed.callsign} {parsed.vertical} FL{wanted}: it is at FL{level:.0f} (allowed: "
                f"a level {'above' if parsed.vertical == 'climb' else 'below'} FL{level:.0f})"
            )
        return ticks(float(wanted))

    def _route(self, slot: int) -> tuple[str, ...]:
        return self.world.sector.routes[int(self.state.traffic.route[slot])]

    def phrased(self, transmission: Transmission) -> Instruction:
        """A transmission with the wording of what would be flown."""
        slot = transmission.slot
        callsign = self.callsigns[slot]
        traffic = self.state.traffic
        (worded,) = in_words(
            [instruction_of(transmission, callsign, self._route(slot))],
            np.asarray(traffic.heading_deg[slot], dtype=np.float64)[None],
            np.asarray(traffic.level_ticks[slot], dtype=np.float64)[None] / TICKS_PER_FL,
            SKYSTACK,
        )
        return worded
