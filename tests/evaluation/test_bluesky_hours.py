"""Our arriving traffic, flown in BlueSky."""

from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("bluesky")

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.errors import InputError
from skystack.evaluation.bluesky_hours import BlueskyHours
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.traffic import evaluate_traffic
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.simulator.arrivals import FREE

CYCLES = 260
WORLD = find_controller("no-op", TrafficConditions("60")).world


@pytest.fixture(scope="module", params=["own-navigation-exit-level", "no-op"])
def flown(request):
    """The same hour in both simulators."""
    with closing(BlueskyHours(WORLD)) as hours:
        return [
            HourFlyer(WORLD, CYCLES, 5, each).fly(SECTOR_AGENTS[request.param](WORLD, 5), 3, 0)
            for each in (None, hours)
        ]


@pytest.mark.slow
def test_the_same_flights_are_born_in_the_same_cycles(flown):
    births = []
    for hour in flown:
        first = {}
        for cycle, slot in np.argwhere(hour.flight != FREE).tolist():
            first.setdefault(int(hour.candidate[cycle, slot]), cycle)
        births.append(first)
    assert births[0] == births[1]
    assert len(births[0]) > 15


@pytest.mark.slow
def test_flights_fly_nearly_alike(flown):
    """Both fly the same headings, levels and airspeeds. BlueSky adopts a clearance one cycle
    earlier, turns with 25 degrees of bank, and accelerates into climbs and descents."""
    ours, theirs = flown
    last = []
    for hour in flown:
        left = np.argwhere(hour.exited | hour.excursion).tolist()
        last.append({int(hour.flight[cycle, slot]): cycle for cycle, slot in left})
    assert len(last[0]) > 3
    assert last[0].keys() == last[1].keys()
    assert max(abs(last[0][flight] - last[1][flight]) for flight in last[0]) <= 3
    both = (ours.flight == theirs.flight) & (ours.flight != FREE)
    assert both.sum() > 1500
    one, other = (np.asarray(each.traffic.position_nm)[both] for each in flown)
    assert np.hypot(*(one - other).T).max() < 2.0
    levels = [np.asarray(each.traffic.level_ticks)[both] / 6000.0 for each in flown]
    assert np.abs(levels[0] - levels[1]).max() < 15.0


@pytest.mark.slow
def test_exits_are_the_same(flown):
    ours, theirs = ({int(each.flight[at]) for at in map(tuple, np.argwhere(each.exited_correctly))}
                    for each in flown)  # fmt: skip
    assert ours == theirs


@pytest.mark.slow
def test_flight_school_newborns_are_held_as_in_our_simulator():
    """They move two cycles or more after they are born."""
    row = [
        evaluate_traffic("own-navigation", TrafficConditions("category", cycles=60, platform=name))
        for name in ("skystack", "bluesky")
    ]
    for name in ("flights", "losses_of_separation", "losses_at_birth", "transmissions_per_flight"):
        assert row[0][name] == row[1][name]


@pytest.mark.slow
def test_mvp_flies_in_bluesky_only():
    few = TrafficConditions("60", cycles=30)
    with pytest.raises(InputError, match="mvp flies in BlueSky only"):
        evaluate_traffic("mvp", few)
    row = evaluate_traffic("mvp", few._replace(platform="bluesky"))
    assert (row["agent"], row["platform"]) == ("mvp", "bluesky")


@pytest.mark.slow
def test_uncertainty_and_other_sectors_are_flown():
    few = TrafficConditions("60", cycles=60, platform="bluesky", uncertainty=True)
    row = evaluate_traffic("own-navigation", few._replace(sector="highland"))
    assert row["flights"] > 0
    assert row["sector"] == "highland"
