"""BluebirdDT's own traffic: what agents see of it, and what becomes of their clearances."""

import jax
import numpy as np
import pytest

pytest.importorskip("bluebird_dt")

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.agents.transmission import Transmission, clearance_of
from skystack.evaluation.bluebird_hours import BluebirdHours
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.platforms.bluebird_traffic import FlightSchoolTraffic
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL
from skystack.simulator.arrivals import FREE
from skystack.simulator.simulator import instruct
from skystack.simulator.traffic import ticks

CYCLES = 150
WORLD = find_controller("no-op", TrafficConditions("category")).world
SLOTS = WORLD.flow.slots


class Flown:
    """An hour that was flown: states before each cycle, transmissions, cycles, states after."""

    def __init__(self, agent, cycles=CYCLES, number=0):
        hours = BluebirdHours(WORLD, FlightSchoolTraffic(FLIGHT_SCHOOL["category"]))
        state = hours.reset(7, number)
        agent.begin(state)
        self.rows = []
        for _ in range(cycles):
            sent = agent.transmit(state)
            after, cycle = hours.advance(state, sent)
            self.rows.append((state, sent, cycle, after))
            state = after
        self.reports = hours.platform._reports()
        hours.close()


@pytest.fixture(scope="module")
def flown():
    """Turns, clearances direct to fixes and changes of level."""
    return Flown(SECTOR_AGENTS["rules"](WORLD, 5))


@pytest.mark.slow
def test_every_cycle_is_flown_as_in_our_simulator(flown):
    """From what an agent sees of BluebirdDT, with the agent's clearances."""
    fly = jax.jit(lambda traffic, clearance: WORLD.simulator.advance(instruct(traffic, clearance)))
    worst_nm, levels, headings = [], [], []
    for before, sent, cycle, _ in flown.rows:
        ours = jax.device_get(fly(before.traffic, clearance_of(sent, SLOTS)))
        there = before.traffic.active & (before.arrivals.held == 0) & cycle.traffic.active
        offset = (ours.position_nm - cycle.traffic.position_nm)[there]
        worst_nm.append(np.hypot(*offset.T).max(initial=0.0))
        levels.append((ours.level_ticks == cycle.traffic.level_ticks)[there])
        turn = (ours.heading_deg - cycle.traffic.heading_deg)[there]
        headings.append(np.abs((turn + 180.0) % 360.0 - 180.0).max(initial=0.0))
        for name in ("cleared_level_ticks", "own_navigation", "next_fix"):
            both = (getattr(traffic, name)[there] for traffic in (ours, cycle.traffic))
            np.testing.assert_array_equal(*both)
    assert max(worst_nm) < 0.02
    assert np.concatenate(levels).all()
    assert max(headings) < 0.2
    assert any(before.traffic.turn_radius_nm.max() > 0.0 for before, *_ in flown.rows)


@pytest.mark.slow
def test_flights_are_born_at_their_places_and_leave_once(flown):
    born = [int(c.flight[slot]) for _, _, c, _ in flown.rows for slot in np.flatnonzero(c.born)]
    starters = (flown.rows[0][0].arrivals.flight != FREE).sum()
    assert born == list(range(starters, starters + len(born)))
    left = [
        int(c.flight[slot])
        for _, _, c, _ in flown.rows
        for slot in np.flatnonzero(c.exited | c.excursion)
    ]
    assert len(left) == len(set(left)) > 3
    _, _, _, last = flown.rows[-1]
    present = set(last.arrivals.flight[last.traffic.active].tolist())
    assert set(range(starters + len(born))) == present | set(left)


@pytest.mark.slow
def test_entry_and_exit_levels_are_the_coordinated_ones(flown):
    _, _, _, last = flown.rows[-1]
    present = last.arrivals.flight != FREE
    for plan in (last.plan.entry_level_ticks, last.plan.exit_level_ticks):
        level = plan[present] / ticks(10.0)
        assert np.array_equal(level, np.round(level))
        assert (level >= 20).all()
        assert (level <= 40).all()
    entered = [c for _, _, c, _ in flown.rows if c.born.any()]
    for cycle in entered:
        assert (cycle.before_level_ticks[cycle.born] == cycle.traffic.level_ticks[cycle.born]).all()


class Once:
    """Tells every flight once, as soon as it hears."""

    def __init__(self, **clearance):
        self.clearance = clearance

    def begin(self, state):
        self.told = {}

    def transmit(self, state):
        new = [
            slot
            for slot in np.flatnonzero(state.hears).tolist()
            if int(state.arrivals.flight[slot]) not in self.told
        ]
        cycle = int(state.arrivals.cycle)
        self.told |= {int(state.arrivals.flight[slot]): cycle for slot in new}
        return [Transmission(slot, **self.clearance) for slot in new]


@pytest.mark.slow
def test_newborns_hear_as_soon_as_clearances_are_kept():
    agent = Once(level_ticks=ticks(300.0))
    flown = Flown(agent, 80)
    assert len(agent.told) > 8
    assert max(before.arrivals.held.sum() for before, *_ in flown.rows) > 0
    before, _, _, _ = flown.rows[-1]
    for slot in np.flatnonzero(before.hears):
        if agent.told.get(int(before.arrivals.flight[slot]), CYCLES) < len(flown.rows) - 1:
            assert before.traffic.cleared_level_ticks[slot] == ticks(300.0)
    born = {
        int(cycle.flight[slot]): number + 1
        for number, (_, _, cycle, _) in enumerate(flown.rows)
        for slot in np.flatnonzero(cycle.born)
    }
    waits = [told - born[flight] for flight, told in agent.told.items() if flight in born]
    assert min(waits) == 1  # as in our simulator


@pytest.mark.slow
def test_flights_that_bluebird_removes_are_excursions():
    """Newborns that are turned back before they enter."""

    class TurnsBack(Once):
        def transmit(self, state):
            headings = (state.traffic.heading_deg + 180.0).round().astype(int) % 360
            return [
                each._replace(heading_deg=int(headings[each.slot]))
                for each in super().transmit(state)
            ]

    flown = Flown(TurnsBack(heading_deg=0), 120)
    left = sum(int((cycle.exited | cycle.excursion).sum()) for _, _, cycle, _ in flown.rows)
    _, _, _, last = flown.rows[-1]
    assert left > 2
    assert np.array_equal(last.traffic.active, last.arrivals.flight != FREE)
    assert int(last.arrivals.born) == left + last.traffic.active.sum()
    assert last.traffic.active.sum() == len(flown.reports)


def test_a_clearance_direct_to_a_fix_does_not_change_the_routes_of_others(flown):
    """BluebirdDT lets flights on the same route share it."""
    routes = [tuple(report.route) for report in flown.reports.values()]
    assert len(set(routes)) < len(routes)
    for report in flown.reports.values():
        assert report.next_fix is None or report.next_fix in report.route


@pytest.mark.slow
def test_hours_depend_on_their_seed_and_number_only():
    positions = [
        Flown(SECTOR_AGENTS["no-op"](WORLD, 1), 30, number).rows[-1][-1].traffic.position_nm
        for number in (0, 0, 1)
    ]
    np.testing.assert_array_equal(positions[0], positions[1])
    assert not np.array_equal(positions[0], positions[2])


def test_nothing_is_printed_or_written(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Flown(SECTOR_AGENTS["own-navigation"](WORLD, 5), 20)
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []
