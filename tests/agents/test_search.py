"""The what-if search and the rules it is compared with, on traffic of minutes to an hour."""

from functools import cache

import numpy as np
import pytest

from skystack.agents.probe import AHEAD, PLANS, Probe, flights_in, no_events, set_event
from skystack.agents.search import SHORT, Search
from skystack.agents.sector_rules import NoOp, OwnNavigation, Rules
from skystack.agents.transmission import Transmission
from skystack.airspace.sectors import sector_named
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation.hour_scores import score, summary
from skystack.evaluation.hours import HourFlyer, OwnHours
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.arrivals import Clock
from skystack.simulator.performance import TICKS_PER_FL, performance
from skystack.simulator.simulator import Simulator
from skystack.simulator.timetable import ListedFlight, TimetableFlow
from skystack.tasks.sector_world import World

SIMULATOR = Simulator(x_plus(), performance("constant"), own_navigation=True)
WORLD = World(Flow(SIMULATOR, constant_rate(90.0), slots=48, candidates=256))
FLYER = HourFlyer(WORLD, cycles=450, per_cycle=1)
AGENTS = {
    "no-op": NoOp,
    "levels kept": lambda: OwnNavigation(False, per_cycle=1),
    "own navigation": lambda: OwnNavigation(True, per_cycle=1),
    "rules": lambda: Rules(WORLD, per_cycle=1),
    "search": lambda: Search(WORLD, per_cycle=1),
}


@cache
def row(name):
    """The summary of 45 minutes, which are the same traffic for every agent at first."""
    return summary([score(WORLD.sector, FLYER.fly(AGENTS[name](), 0, 3))], name, "90")


@pytest.mark.slow
def test_the_search_keeps_everybody_separated_and_delivers_every_flight():
    found = row("search")
    assert found["flights_gone"] > 30
    assert found["losses_of_separation"] == 0
    assert found["correct_exit_rate"] == 1.0
    assert found["transmissions_per_flight"] < 1.6
    assert found["exit_offset_nm_median"] < 0.1
    assert found["lax_s_mean"] == found["strict_s_mean"] == 6 * 450


@pytest.mark.slow
def test_the_same_traffic_without_a_controller_that_looks_ahead_loses_separation():
    assert row("own navigation")["losses_of_separation"] > 5
    assert row("own navigation")["correct_exit_rate"] == 1.0
    assert row("no-op")["correct_exit_rate"] < 0.2
    assert row("levels kept")["correct_exit_rate"] < 0.3
    assert row("levels kept")["excursion_rate"] == 0.0


@pytest.mark.slow
def test_turning_away_avoids_some_losses():
    avoided, own = row("rules"), row("own navigation")
    assert avoided["losses_of_separation"] < own["losses_of_separation"]
    assert avoided["transmissions_per_flight"] > own["transmissions_per_flight"]


@pytest.mark.slow
def test_own_navigation_transmits_once_to_each_flight():
    hour = FLYER.fly(OwnNavigation(True, per_cycle=1), 0, 3)
    flights = [each.flight for each in hour.sent]
    assert len(flights) == len(set(flights))
    assert np.bincount([each.cycle for each in hour.sent]).max() == 1


@pytest.mark.slow
def test_the_search_finds_the_same_plans_again():
    first, second = (FLYER.fly(Search(WORLD, per_cycle=1), 0, 3).sent for _ in range(2))
    assert first == second


class Talkative(NoOp):
    def __init__(self, transmissions):
        self.transmissions = transmissions

    def transmit(self, state):
        return self.transmissions


def test_refuses_too_many_transmissions_and_free_slots():
    from skystack.agents.transmission import Transmission

    with pytest.raises(InputError, match=r"2 transmissions in a cycle \(allowed: 1\)"):
        FLYER.fly(Talkative([Transmission(0, fix=1), Transmission(1, fix=1)]), 0, 3)
    with pytest.raises(InputError, match="slot 5, which is free"):
        FLYER.fly(Talkative([Transmission(5, fix=1)]), 0, 3)


def listed_world(sector, flights, cycles=400):
    simulator = Simulator(sector, performance("constant"), own_navigation=True)
    clock = Clock(0.0, recorded=True)
    return World(TimetableFlow(simulator, clock, slots=4, cycles=cycles, flights=tuple(flights)))


def at_first_fix(sector, route, callsign, ahead_nm=0.0, level_fl=300.0):
    """A flight at the start, at the first fix of a route or beyond it, in contact."""
    heading = sector.first_heading_deg(route)
    fix = sector.plane.to_plane(*sector.fixes[route[0]])
    step = ahead_nm * np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))])
    lat, lon = sector.plane.to_degrees(fix + step)
    return ListedFlight(
        callsign, 0, route, 0, 0.0, float(lat), float(lon), heading, level_fl, level_fl, level_fl,
        own_navigation=False,
    )  # fmt: skip


@pytest.mark.slow
def test_plans_reach_the_end_of_the_longest_route():
    """At 400 kt, an aircraft flies 0.667 NM in a cycle."""
    highland = sector_named("highland")
    table = highland.route_table
    lengths_nm = [
        float(table.leg_nm[number, : table.exit_fix[number]].sum())
        for number in range(len(highland.routes))
    ]
    longest = highland.routes[int(np.argmax(lengths_nm))]
    world = listed_world(highland, [at_first_fix(highland, longest, "LONG")])
    assert max(lengths_nm) / (400.0 / 600.0) > AHEAD
    assert Probe(world).ahead > 1.2 * max(lengths_nm) / (400.0 / 600.0)
    hour = HourFlyer(world, 400).fly(Search(world), 0, 0)
    (flight,) = score(highland, hour).flights
    assert flight.correct
    x_plus_world = listed_world(x_plus(), [at_first_fix(x_plus(), x_plus().routes[0], "SHORT")])
    assert Probe(x_plus_world).ahead == AHEAD


class Scripted:
    """Gives planned transmissions, by cycle, to flights that are there."""

    def __init__(self, planned):
        self.planned = planned

    def begin(self, state):
        pass

    def transmit(self, state):
        planned = self.planned.get(int(state.arrivals.cycle), [])
        return [each for each in planned if state.hears[each.slot]]


@pytest.mark.slow
@pytest.mark.parametrize(("back_after", "correct"), [(10, True), (70, False)])
def test_plans_that_stray_far_from_the_sector_are_wrong(back_after, correct):
    """A flight that has not entered turns back, and returns to its route after some cycles.

    In 70 cycles at 400 kt, it flies 47 NM. It is then more than 20 NM outside the sector, which is
    an excursion.
    """
    sector = x_plus()
    start = at_first_fix(sector, sector.routes[0], "STRAY", ahead_nm=-3.0)
    world = listed_world(sector, [start])
    away = round(start.heading_deg + 180.0) % 360
    planned = {0: [Transmission(0, heading_deg=away)], back_after: [Transmission(0, fix=1)]}
    hour = HourFlyer(world, 239).fly(Scripted(planned), 0, 0)
    (flight,) = score(sector, hour).flights
    assert (flight.correct, flight.excursion) == (correct, not correct)
    events = no_events(PLANS)
    for index, (cycle, (each,)) in enumerate(planned.items()):
        set_event(events, 0, index, cycle, each)
    state = OwnHours(world).reset(0, 0)
    flown = Probe(world).fly(*flights_in(state, np.zeros(PLANS, dtype=int)), events)
    assert bool(flown.correct[0]) is correct
    assert int(flown.cycles[0]) == flight.gone + 1


@pytest.mark.slow
def test_conflicts_that_cannot_be_avoided_are_left_quickly():
    """Two flights of one route, 2 NM apart at one level, lose separation at once."""
    sector = x_plus()
    route = sector.routes[0]
    world = listed_world(
        sector, [at_first_fix(sector, route, "FIRST", 2.0), at_first_fix(sector, route, "SECOND")]
    )
    search, counted = Search(world), []
    fly = search.probe.fly
    search.probe.__dict__["fly"] = lambda *values: counted.append(1) or fly(*values)
    hour = HourFlyer(world, 250).fly(search, 0, 0)
    scores = score(sector, hour)
    assert [each.cycle for each in scores.losses] == [0]
    assert all(flight.correct for flight in scores.flights)
    offset_nm = hour.traffic.position_nm[:, 0] - hour.traffic.position_nm[:, 1]
    gap = np.abs(hour.traffic.level_ticks[:, 0] - hour.traffic.level_ticks[:, 1])
    lost = (
        (np.hypot(*offset_nm.T) < 4.9)
        & (gap < 10 * TICKS_PER_FL)
        & hour.traffic.active[:, :2].all(1)
    )
    # Climbing or descending 1,000 ft takes five cycles at 2,000 ft/min.
    assert 1 <= np.count_nonzero(lost) <= SHORT
    # A search without success takes 17 batches for each flight, in every cycle of the conflict.
    assert len(counted) < 60


@pytest.mark.slow
def test_flights_that_are_born_close_are_kept_separated():
    """Two flights side by side, 5.05 NM apart and converging, are within the margin at once."""
    sector = x_plus()
    route = sector.routes[0]
    left = at_first_fix(sector, route, "LEFT")
    heading = np.radians(left.heading_deg)
    at_nm = sector.plane.to_plane(left.lat, left.lon)
    at_nm = at_nm + 5.05 * np.array([np.cos(heading), -np.sin(heading)])
    lat, lon = (float(value) for value in sector.plane.to_degrees(at_nm))
    right = left._replace(
        callsign="RIGHT", lat=lat, lon=lon, heading_deg=(left.heading_deg - 2.0) % 360.0
    )
    world = listed_world(sector, [left, right])
    hour = HourFlyer(world, 250).fly(Search(world), 0, 0)
    scores = score(sector, hour)
    assert all(flight.correct for flight in scores.flights)
    assert not scores.losses


@pytest.mark.slow
@pytest.mark.parametrize(
    "lower_flight",
    [
        pytest.param({"exit_fl": 340.0}, id="that must climb"),
        pytest.param({"contact_s": 60.0}, id="that is on frequency a minute later"),
    ],
)
def test_a_flight_does_not_descend_through_the_level_of_one_below(lower_flight):
    """The other flight is 1,000 ft below, at the same position."""
    sector = x_plus()
    route = sector.routes[0]
    upper = at_first_fix(sector, route, "UPPER", level_fl=300.0)._replace(exit_fl=260.0)
    lower = at_first_fix(sector, route, "LOWER", level_fl=290.0)._replace(**lower_flight)
    world = listed_world(sector, [upper, lower])
    hour = HourFlyer(world, 250).fly(Search(world), 0, 0)
    scores = score(sector, hour)
    assert not scores.losses
    assert all(flight.correct for flight in scores.flights)
