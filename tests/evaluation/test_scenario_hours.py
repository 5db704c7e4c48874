"""Scenarios without arrivals in other simulators: the same flights and clearances as in ours."""

from contextlib import closing

import numpy as np
import pytest

from skystack.agents.transmission import Transmission
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hours import Hours
from skystack.evaluation.scenario_hours import ScenarioHours
from skystack.evaluation.scenario_traffic import scenario_world
from skystack.evaluation.traffic import open_hours
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.simulator.traffic import ticks

CYCLES = 40


def flown(traffic, platform, sent):
    """The state after each cycle; `sent` are the transmissions by the number of cycles flown."""
    conditions = TrafficConditions(traffic, platform=platform)
    with closing(open_hours(find_controller("no-op", conditions), conditions)) as hours:
        states = [hours.reset(1, 0)]
        for cycle in range(CYCLES):
            states.append(hours.advance(states[-1], sent.get(cycle, []))[0])
    return states


HEADINGS = {3: [Transmission(0, heading_deg=330)], 20: [Transmission(1, heading_deg=90)]}
LEVEL = {5: [Transmission(0, level_ticks=ticks(200.0))]}
DIRECT = {2: [Transmission(0, heading_deg=200)], 20: [Transmission(0, fix=3)]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("traffic", "platform", "sent", "below_nm"),
    [
        ("lateral", "skystack", HEADINGS, 1e-3),
        ("lateral", "bluebird", HEADINGS, 0.02),
        ("lateral", "bluebird", DIRECT, 0.2),
        ("vertical", "bluebird", LEVEL, 0.02),
        ("lateral", "bluesky", HEADINGS, 0.5),
    ],
)
def test_flights_fly_as_in_our_simulator(traffic, platform, sent, below_nm):
    if platform != "skystack":
        pytest.importorskip({"bluebird": "bluebird_dt", "bluesky": "bluesky"}[platform])
    ours = flown(traffic, "skystack", sent)
    if platform == "skystack":  # through the protocol of platforms
        found = scenario_world(traffic)
        with closing(ScenarioHours(found.world, "skystack", found.performance)) as hours:
            assert isinstance(hours, Hours)
            theirs = [hours.reset(1, 0)]
            for cycle in range(CYCLES):
                theirs.append(hours.advance(theirs[-1], sent.get(cycle, []))[0])
    else:
        theirs = flown(traffic, platform, sent)
    assert all(isinstance(each.traffic.position_nm, np.ndarray) for each in theirs)
    active = np.asarray(ours[-1].traffic.active)
    assert active.any()
    for one, other in zip(ours, theirs, strict=True):
        apart = np.asarray(one.traffic.position_nm) - np.asarray(other.traffic.position_nm)
        assert np.hypot(*apart[active].T).max() < below_nm
        np.testing.assert_array_equal(one.traffic.active, other.traffic.active)
        np.testing.assert_array_equal(one.traffic.own_navigation, other.traffic.own_navigation)
    np.testing.assert_allclose(
        ours[-1].traffic.level_ticks[active], theirs[-1].traffic.level_ticks[active], atol=300.0
    )


def test_nothing_is_asked_of_a_simulator_once_all_flights_have_left():
    class Gone:
        def advance(self):
            raise AssertionError("it may have removed all flights")

    found = scenario_world("vertical")
    with closing(ScenarioHours(found.world, "skystack", found.performance)) as hours:
        state = hours.reset(0, 0)
        nobody = state._replace(
            traffic=state.traffic._replace(active=np.zeros_like(state.traffic.active))
        )
        hours.platform = Gone()
        after, _ = hours.advance(nobody, [])
    assert int(after.arrivals.cycle) == 1
