"""The cycles since the last transmission to each flight."""

from types import SimpleNamespace

import numpy as np

from skystack.agents.since import SinceTransmission
from skystack.agents.transmission import Transmission
from skystack.simulator.arrivals import FREE
from skystack.tasks.sector_observation import SINCE_CYCLES
from skystack.tasks.sector_world import WorldState


def state_of(*flights):
    """A state with only the flights in the slots."""
    return WorldState(None, SimpleNamespace(flight=np.array(flights)), None)


def test_counts_cycles_since_the_last_transmission():
    since = SinceTransmission(3)
    state = state_of(0, 1, FREE)
    assert since.cycles(state).tolist() == [SINCE_CYCLES] * 3
    since.end_cycle([Transmission(1, heading_deg=90)])
    assert since.cycles(state)[1] == 1.0
    since.end_cycle([])
    assert since.cycles(state).tolist() == [SINCE_CYCLES, 2.0, SINCE_CYCLES]


def test_a_new_flight_in_the_slot_begins_anew():
    since = SinceTransmission(1)
    since.cycles(state_of(0))
    since.end_cycle([Transmission(0, heading_deg=90)])
    assert since.cycles(state_of(7)).tolist() == [SINCE_CYCLES]


def test_later_transmissions_do_not_change_what_was_returned():
    since = SinceTransmission(1)
    before = since.cycles(state_of(0))
    since.end_cycle([Transmission(0, heading_deg=90)])
    assert before.tolist() == [SINCE_CYCLES]
