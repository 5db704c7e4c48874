"""BluebirdDT's own traffic: what agents see of it, and what becomes of their clearances."""

import jax
import numpy as np
import pytest

pytest.importorskip("bluebird_dt")

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.agents.transmission import Transmission, clearance_of
from skystack.evaluation.bluebird_hours import BluebirdHours
from skystack.evaluation.traffic import TrafficConditions, find_controller
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL
from skystack.simulator.arrivals import FREE
from skystack.simulator.simulator import instruct
from skystack.simulator.traffic import ticks

CYCLES = 200
WORLD = find_controller("no-op", TrafficConditions("category")).world
SLOTS = WORLD.flow.slots


class Flown:
    """An hour that was flown: states before each cycle, transmissions, cycles, states after."""

    def __init__(self, agent, cycles=CYCLES, number=0):
        hours = BluebirdHours(WORLD, FLIGHT_SCHOOL["category"])
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


def test_newborns_do_not_hear_until_they_have_been_put_back():
    class ClimbsAtOnce:
        def begin(self, state):
            self.told = {}

        def transmit(self, state):
            sent = []
            for slot in np.flatnonzero(state.hears).tolist():
                if int(state.arrivals.flight[slot]) not in self.told:
                    level = ticks(300.0)
                    self.told[int(state.arrivals.flight[slot])] = slot
                    sent.append(Transmission(slot, level_ticks=level))
            return sent[:5]

    agent = ClimbsAtOnce()
    flown = Flown(agent, 80)
    _, _, _, last = flown.rows[-1]
    assert len(agent.told) > 6
    held = [before.arrivals.held.sum() for before, *_ in flown.rows]
    assert max(held) > 0
    told_long_ago = [
        slot
        for number, slot in agent.told.items()
        if last.arrivals.flight[slot] == number and last.hears[slot]
    ]
    cleared = last.traffic.cleared_level_ticks[told_long_ago]
    assert (cleared == ticks(300.0)).mean() > 0.9  # the last may have been told just now


def test_a_clearance_direct_to_a_fix_does_not_change_the_routes_of_others(flown):
    """BluebirdDT lets flights on the same route share it."""
    routes = [tuple(report.route) for report in flown.reports.values()]
    assert len(set(routes)) < len(routes)
    for report in flown.reports.values():
        assert report.next_fix is None or report.next_fix in report.route


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
