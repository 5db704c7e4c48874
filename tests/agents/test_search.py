"""The what-if search and the rules it is compared with, on traffic of minutes to an hour."""

from functools import cache

import numpy as np
import pytest

from skystack.agents.search import Search
from skystack.agents.sector_rules import NoOp, OwnNavigation, Rules
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation.hour_scores import score, summary
from skystack.evaluation.hours import HourFlyer
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
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


def test_the_search_keeps_everybody_separated_and_delivers_every_flight():
    found = row("search")
    assert found["flights_gone"] > 30
    assert found["losses_of_separation"] == 0
    assert found["correct_exit_rate"] == 1.0
    assert found["transmissions_per_flight"] < 1.6
    assert found["exit_offset_nm_median"] < 0.1
    assert found["lax_s_mean"] == found["strict_s_mean"] == 6 * 450


def test_the_same_traffic_without_a_controller_that_looks_ahead_loses_separation():
    assert row("own navigation")["losses_of_separation"] > 5
    assert row("own navigation")["correct_exit_rate"] == 1.0
    assert row("no-op")["correct_exit_rate"] < 0.2
    assert row("levels kept")["correct_exit_rate"] < 0.3
    assert row("levels kept")["excursion_rate"] == 0.0


def test_turning_away_avoids_some_losses():
    avoided, own = row("rules"), row("own navigation")
    assert avoided["losses_of_separation"] < own["losses_of_separation"]
    assert avoided["transmissions_per_flight"] > own["transmissions_per_flight"]


def test_own_navigation_transmits_once_to_each_flight():
    hour = FLYER.fly(OwnNavigation(True, per_cycle=1), 0, 3)
    flights = [each.flight for each in hour.sent]
    assert len(flights) == len(set(flights))
    assert np.bincount([each.cycle for each in hour.sent]).max() == 1


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
