"""A session in a terminal or over a pipe: lines in, lines out.

AC1 turn left heading 240, climb FL340    issues a clearance; no time passes
(an empty line) or a number               flies one cycle, or so many
flights                                   shows the flights and predicted conflicts
advise, accept                            asks the adviser, and issues what it proposed
help, quit
"""

from itertools import zip_longest

from skystack.agents.transmission import SectorAgent, Transmission
from skystack.errors import InputError
from skystack.live.hour import LiveHour
from skystack.live.situation import Conflict, FlightStrip, Situation
from skystack.platforms.phraseology import read_back, written
from skystack.simulator.simulator import CYCLE_S

HELP = (
    "CALLSIGN CLEARANCE   such as: AC1 turn left heading 240, climb FL340",
    "                     or: AC1 direct FIRE; AC1 left 20 degrees",
    "                     or: AC1 resume own navigation",
    "empty line, or N     fly one radar cycle (6 s), or N",
    "flights              the flights, and conflicts predicted within ten minutes",
    "advise, accept       what the adviser would transmit now; transmit it",
    "quit                 end the session; what was flown is saved",
)
_HEADER = ("flight", "level", "exit", "heading", "kt", "next", "conflict")


class TextSession:
    """Answers the lines of a session."""

    def __init__(self, hour: LiveHour, adviser: SectorAgent | None, cycles: int) -> None:
        """`cycles` is the length of the hour."""
        self.hour, self._adviser, self._cycles = hour, adviser, cycles
        self._situation = Situation(hour)
        self._proposed: list[Transmission] = []
        self._advised: int | None = None
        """The cycle of the last advice, unless a clearance was issued since."""
        self.ended = False

    def answer(self, line: str) -> list[str]:
        """The lines that answer a line. Raises InputError if it is not understood."""
        words = line.split()
        if not words:
            return self._fly(1)
        if len(words) == 1:
            word = words[0].casefold()
            if word.isascii() and word.isdigit():
                return self._fly(int(word[:20]))
            if word in ("flights", "advise", "accept", "help", "quit"):
                answer: list[str] = getattr(self, f"_{word}")()
                return answer
        issued = self.hour.issue(line)
        self._advised = None  # the adviser did not know of it
        return [f'"{read_back(issued)}"']

    def _fly(self, cycles: int) -> list[str]:
        most = self._cycles - self.hour.cycle
        if not 1 <= cycles <= most:
            raise InputError(f"{cycles} cycles (allowed: 1 to {most}, the rest of the session)")
        lines = []
        for _ in range(cycles):
            lines += self._fly_one()
        self.ended = self.hour.cycle >= self._cycles
        return [*lines, self._now()]

    def _fly_one(self) -> list[str]:
        before = dict(self.hour.slots)
        cycle = self.hour.advance()
        time = _clock(self.hour.cycle * CYCLE_S)
        lines = [f"{time} {name} arrives" for name in self.hour.slots if name not in before]
        for name, slot in before.items():
            if cycle.exited_correctly[slot]:
                lines.append(f"{time} {name} leaves through its exit")
            elif cycle.exited[slot]:
                lines.append(f"{time} {name} leaves through its exit, at the wrong level")
            elif cycle.excursion[slot]:
                lines.append(f"{time} {name} leaves the sector elsewhere")
        return lines

    def _now(self) -> str:
        time, count = _clock(self.hour.cycle * CYCLE_S), len(self.hour.slots)
        conflicts = self._situation.conflicts()
        words = f"{time} {count} flight{'' if count == 1 else 's'}"
        for each in conflicts[:3]:
            words += f"; {' and '.join(each.callsigns)}: {_conflict(each)}"
        return words + (f"; {len(conflicts) - 3} more" if len(conflicts) > 3 else "")

    def _flights(self) -> list[str]:
        soonest: dict[str, str] = {}
        for each in self._situation.conflicts():
            for name, other in (each.callsigns, each.callsigns[::-1]):
                soonest.setdefault(name, f"{other} {_conflict(each)}")
        rows = [_cells(each, soonest.get(each.callsign, "")) for each in self._situation.flights()]
        return aligned([_HEADER, *rows]) if rows else ["no flights"]

    def _advise(self) -> list[str]:
        if self._adviser is None:
            raise InputError(
                "there is no adviser (allowed: start the session with --adviser AGENT)"
            )
        if self._advised != self.hour.cycle:  # an adviser is asked once in a cycle
            # Asked afresh: what it planned earlier may not have been transmitted.
            self._adviser.begin(self.hour.state)
            self._proposed = self._adviser.transmit(self.hour.state)
            self._advised = self.hour.cycle
        proposed = [written(self.hour.phrased(each)) for each in self._proposed]
        return proposed or ["nothing to transmit"]

    def _accept(self) -> list[str]:
        if self._advised != self.hour.cycle or not self._proposed:
            raise InputError(
                "nothing to accept (allowed: after `advise` has proposed a transmission)"
            )
        self._advised = None
        issued = [self.hour.transmit(each) for each in self._proposed]
        return [f'"{read_back(each)}"' for each in issued]

    def _help(self) -> list[str]:
        return list(HELP)

    def _quit(self) -> list[str]:
        self.ended = True
        return []


def _cells(flight: FlightStrip, conflict: str) -> tuple[str, ...]:
    level = f"{flight.fl:03.0f}"
    if abs(flight.fl - flight.cleared_fl) >= 0.5:
        level += f" to {flight.cleared_fl:03d}"
    heading = f"{flight.heading_deg:03d}"
    if flight.cleared_heading_deg is None:
        heading += " own"
    elif flight.cleared_heading_deg != flight.heading_deg:
        heading += f" to {flight.cleared_heading_deg:03d}"
    return (
        flight.callsign if flight.hears else f"({flight.callsign})",
        level,
        f"{flight.exit_fl:03d} {flight.exit_fix}",
        heading,
        str(flight.speed_kt),
        flight.next_fix,
        conflict,
    )


def aligned(rows: list[tuple[str, ...]]) -> list[str]:
    """Rows as lines whose columns are aligned."""
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _conflict(conflict: Conflict) -> str:
    return f"in {_clock(conflict.in_s)}" if conflict.in_s else "separation lost"


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
