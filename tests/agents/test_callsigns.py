"""Callsigns of arriving flights."""

from types import SimpleNamespace

import numpy as np

from skystack.agents.callsigns import Callsigns
from skystack.simulator.arrivals import FREE
from skystack.tasks.sector_world import WorldState


def state_of(flight, candidate):
    """A state with only the flight and the candidate in each slot."""
    arrivals = SimpleNamespace(flight=np.array(flight), candidate=np.array(candidate))
    return WorldState(None, arrivals, None)


def test_flights_are_named_by_candidate_and_found_by_slot():
    names = Callsigns()
    assert names.follow(state_of([FREE, 0], [0, 4])) == {"AC5": 1}
    assert names.follow(state_of([2, 0, 1], [9, 4, 7])) == {"AC10": 0, "AC5": 1, "AC8": 2}
    assert names.follow(state_of([2, FREE, 1], [9, 4, 7])) == {"AC10": 0, "AC8": 2}
    assert [names[flight] for flight in range(3)] == ["AC5", "AC8", "AC10"]
    assert "AC5" in names
    assert "AC1" not in names


def test_a_candidate_that_is_used_again_gets_a_suffix():
    names = Callsigns()
    assert [names.add(0), names.add(1), names.add(0), names.add(0)] == [
        "AC1", "AC2", "AC1-2", "AC1-3"
    ]  # fmt: skip
