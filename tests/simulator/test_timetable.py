"""Listed flights: born at their times and places, and in contact from a fixed time."""

import jax
import numpy as np
import pytest

from skystack.agents.transmission import Transmission
from skystack.airspace.xplus import x_plus
from skystack.evaluation.hours import OwnHours
from skystack.simulator.arrivals import FREE, Clock
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import Simulator
from skystack.simulator.timetable import ListedFlight, TimetableFlow
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World
from tests.simulator.test_sampled_performance import BOTH

SECTOR = x_plus()
ROUTE = SECTOR.routes[0]


def listed(callsign, birth_cycle, contact_s, kind=0, cleared_fl=300.0):
    lat, lon = SECTOR.fixes[ROUTE[0]]
    heading = SECTOR.first_heading_deg(ROUTE)
    return ListedFlight(
        callsign, kind, ROUTE, birth_cycle, contact_s, lat, lon, heading, 300.0, cleared_fl, 240.0,
        own_navigation=True,
    )  # fmt: skip


FLIGHTS = (listed("STARTS", 0, 0.0), listed("LATER", 5, 51.0, kind=1, cleared_fl=200.0))
WORLD = World(
    TimetableFlow(
        Simulator(SECTOR, BOTH, own_navigation=True),
        Clock(0.0, recorded=True),
        slots=4,
        cycles=60,
        flights=FLIGHTS,
    )
)


@pytest.fixture(scope="module")
def states():
    """The state after each cycle, from cycle 0."""
    hours = OwnHours(WORLD)
    found = [hours.reset(0, 0)]
    for _ in range(20):
        found.append(hours.advance(found[-1], [])[0])
    return found


@pytest.mark.slow
def test_flights_are_there_from_their_cycles_of_birth(states):
    born = [np.count_nonzero(state.arrivals.flight != FREE) for state in states]
    assert born[:5] == [1] * 5
    assert born[5:] == [2] * (len(born) - 5)
    assert states[-1].arrivals.candidate[:2].tolist() == [0, 1]


def test_they_are_born_as_listed_and_then_move(states):
    fix = SECTOR.plane.to_plane(*SECTOR.fixes[ROUTE[0]])
    assert states[0].traffic.position_nm[0] == pytest.approx(fix, abs=1e-4)
    assert states[1].traffic.position_nm[0] != pytest.approx(fix, abs=0.1)
    assert states[5].traffic.position_nm[1] == pytest.approx(fix, abs=1e-4)
    assert states[6].traffic.position_nm[1] != pytest.approx(fix, abs=0.1)
    assert states[5].traffic.kind[:2].tolist() == [0, 1]


def test_they_fly_to_their_cleared_levels_by_their_own_tables(states):
    level = [float(state.traffic.level_ticks[1]) / TICKS_PER_FL for state in states]
    assert level[5] == 300.0
    # The slow type descends at 1,200 ft/min: 1.2 flight levels in a cycle.
    assert level[6] == pytest.approx(300.0 - 1.2)
    assert states[6].traffic.ground_speed_kt[1] < states[6].traffic.ground_speed_kt[0]


def test_they_hear_from_their_times_of_contact(states):
    """Contact at 51 s is in the ninth cycle, so that the flight hears before the tenth."""
    hears = [state.hears[:2].tolist() for state in states]
    assert [each[0] for each in hears] == [True] * len(hears)
    assert [each[1] for each in hears] == [cycle >= 9 for cycle in range(len(hears))]


def test_own_navigation_ends_with_contact(states):
    own = [state.traffic.own_navigation[1] for state in states[5:]]
    assert own == [cycle < 9 for cycle in range(5, len(states))]
    assert not states[0].traffic.own_navigation[0]
    heading = [state.traffic.heading_deg[1] for state in states[9:]]
    assert heading == pytest.approx([heading[0]] * len(heading))


def test_clearances_before_contact_are_not_heard():
    hours = OwnHours(WORLD)
    state = hours.reset(0, 0)
    for _ in range(7):
        state, _ = hours.advance(state, [])
    transmissions = [Transmission(slot, level_ticks=ticks(320.0)) for slot in (0, 1)]
    state, _ = hours.advance(state, transmissions)
    assert (state.traffic.cleared_level_ticks[:2] / TICKS_PER_FL).tolist() == [320.0, 200.0]


def test_the_hour_is_the_same_for_every_seed():
    hours = OwnHours(WORLD)
    one, other = hours.reset(0, 0), hours.reset(5, 3)
    assert jax.tree.all(
        jax.tree.map(np.array_equal, one._replace(arrivals=None), other._replace(arrivals=None))
    )


def test_without_starters_there_are_no_flights():
    state = OwnHours(World(WORLD.flow.without_starters())).reset(0, 0)
    assert np.all(state.arrivals.flight == FREE)
    assert not state.traffic.active.any()
    assert WORLD.flow.callsigns == ("STARTS", "LATER")
