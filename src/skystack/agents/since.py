"""How long ago each flight received a transmission, which policies observe."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from skystack.agents.transmission import Transmission
from skystack.simulator.arrivals import FREE
from skystack.tasks.sector_observation import SINCE_CYCLES
from skystack.tasks.sector_world import WorldState


class SinceTransmission:
    """Counts the cycles since the last transmission to the flight in each slot."""

    def __init__(self, slots: int) -> None:
        self._flight: Int[np.ndarray, " slots"] = np.full(slots, FREE)
        self._cycles: Float[np.ndarray, " slots"] = np.full(slots, SINCE_CYCLES, np.float32)

    def cycles(self, state: WorldState) -> Float[np.ndarray, " slots"]:
        """The cycles since the last transmission, `[slots]`, at most `SINCE_CYCLES`.

        Begins anew where another flight now uses the slot.
        """
        flight = np.asarray(state.arrivals.flight)
        self._cycles[flight != self._flight] = SINCE_CYCLES
        self._flight = flight.copy()
        return self._cycles.copy()

    def end_cycle(self, sent: Iterable[Transmission]) -> None:
        """End a cycle: begin anew for the flights that received a transmission, and add one."""
        for each in sent:
            self._cycles[each.slot] = 0.0
        self._cycles = np.minimum(self._cycles + 1.0, np.float32(SINCE_CYCLES))
