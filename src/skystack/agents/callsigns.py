"""The callsigns of arriving flights."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from skystack.simulator.arrivals import FREE
from skystack.tasks.sector_world import WorldState


class Callsigns:
    """Names flights in order of birth.

    Callsigns are numbered by candidate: which candidates are admitted, and when, depends on the
    traffic, but a callsign is the same flight under every agent. If the candidates are used up and
    begin again, a suffix is added. Candidates with callsigns of their own keep them.
    """

    def __init__(self, own: Sequence[str] = ()) -> None:
        """`own` are the callsigns of the candidates, if they have their own."""
        self._own, self._uses = own, Counter[int]()
        self._names: list[str] = []

    def add(self, candidate: int) -> str:
        """Name the next flight, which is made from a candidate."""
        self._uses[candidate] += 1
        uses = self._uses[candidate]
        name = self._own[candidate] if 0 <= candidate < len(self._own) else f"AC{candidate + 1}"
        self._names.append(name + (f"-{uses}" if uses > 1 else ""))
        return self._names[-1]

    def follow(self, state: WorldState) -> dict[str, int]:
        """Name the flights born since the last call; it must be called in every cycle.

        Returns the slots of all flights in the state, by callsign.
        """
        flight, candidate = np.asarray(state.arrivals.flight), np.asarray(state.arrivals.candidate)
        slots = np.flatnonzero(flight != FREE)
        for slot in slots[np.argsort(flight[slots])].tolist():
            if flight[slot] >= len(self._names):
                self.add(int(candidate[slot]))
        return {self._names[flight[slot]]: slot for slot in slots.tolist()}

    def __getitem__(self, flight: int) -> str:
        return self._names[flight]

    def __contains__(self, callsign: object) -> bool:
        return callsign in self._names
