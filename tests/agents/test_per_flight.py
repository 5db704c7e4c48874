"""Controllers that choose actions for single flights."""

import jax
import numpy as np
import pytest

from skystack.agents.agent import Agent
from skystack.agents.per_flight import FlightActions, PerFlight
from skystack.agents.transmission import clearance_of
from skystack.errors import InputError
from skystack.simulator.performance import TICKS_PER_FL
from skystack.stacking import NO_OP
from skystack.tasks.sector_control import CLIMB, DESCEND, LEFT_10, NONE, RIGHT_10, TO_FIX
from skystack.tasks.sector_observation import NAMES
from tests.tasks.sector_traffic import ALLOWED, BEGIN, OBSERVE, TASK, TELL, after


@pytest.fixture(scope="module")
def world():
    return jax.device_get(after(60, action=NO_OP).world)


@pytest.fixture(scope="module")
def flights():
    return FlightActions(TASK)


def hearing(world):
    return np.flatnonzero(world.hears).tolist()


@pytest.mark.slow
def test_a_burst_is_one_transmission(world, flights):
    flights.begin()
    slot = hearing(world)[0]
    level_fl = float(world.traffic.cleared_level_ticks[slot]) / TICKS_PER_FL
    heading = float(world.traffic.cleared_heading_deg[slot])
    steps = [CLIMB, CLIMB] if level_fl < 300.0 else [DESCEND, DESCEND]
    (sent,) = flights.transmissions(world, {slot: [LEFT_10, LEFT_10, LEFT_10, *steps]})
    assert (sent.slot, sent.instructions, sent.fix) == (slot, 5, None)
    assert sent.heading_deg == round(heading - 30.0) % 360
    change = 20.0 if level_fl < 300.0 else -20.0
    assert sent.level_ticks == pytest.approx((level_fl + change) * TICKS_PER_FL)


@pytest.mark.slow
def test_what_changes_nothing_is_not_transmitted(world, flights):
    flights.begin()
    one, other, *_ = hearing(world)
    assert flights.transmissions(world, {one: [NONE], other: []}) == []
    sent = flights.transmissions(world, {one: [CLIMB] * 40})
    assert all(each.level_ticks == 400.0 * TICKS_PER_FL for each in sent)
    assert all(each.instructions <= 20 for each in sent)


@pytest.mark.slow
def test_flights_are_observed_as_in_the_task(world, flights):
    flights.begin()
    views, state = flights.observe(world), BEGIN(world)
    np.testing.assert_allclose(views.observation.T, np.asarray(OBSERVE(state)), atol=1e-6)
    np.testing.assert_array_equal(views.allowed.T, ALLOWED(state))
    since = NAMES.index("since")
    assert np.all(views.observation[hearing(world), since] == 1.0)


@pytest.mark.slow
def test_an_agent_of_another_library_chooses_one_action_per_flight(world):
    """It turns every flight that is not on own navigation to the right."""
    own_navigation = NAMES.index("own_navigation")

    def act(rows):
        return np.where(rows[:, own_navigation] > 0.5, NONE, RIGHT_10)

    controller = PerFlight(Agent("turns", act=act), TASK, per_cycle=100)
    controller.begin(world)
    sent = controller.transmit(world)
    expected = [slot for slot in hearing(world) if not world.traffic.own_navigation[slot]]
    assert sorted(each.slot for each in sent) == expected
    told = TELL(world, clearance_of(sent, TASK.agents))
    turned = np.asarray(told.traffic.cleared_heading_deg - world.traffic.cleared_heading_deg)
    assert np.all(np.abs((turned[expected] - 10.0 + 180.0) % 360.0 - 180.0) <= 0.5)


@pytest.mark.slow
def test_the_most_urgent_flights_are_instructed_first(world):
    controller = PerFlight(
        Agent("direct", act=lambda rows: np.full(len(rows), TO_FIX)), TASK, per_cycle=2
    )
    controller.begin(world)
    sent = controller.transmit(world)
    assert len(sent) == 2
    views = FlightActions(TASK).observe(world)
    time_s = views.observation[:, NAMES.index("time to loss, cleared")]
    may = [slot for slot in hearing(world) if views.allowed[slot, TO_FIX]]
    latest = max(time_s[each.slot] for each in sent)
    others = [slot for slot in may if slot not in {each.slot for each in sent}]
    assert latest <= min(time_s[slot] for slot in others)


def test_a_wrong_answer_names_the_flight_and_the_cycle(world):
    controller = PerFlight(Agent("wrong", act=lambda rows: [9] * len(rows)), TASK, per_cycle=2)
    controller.begin(world)
    with pytest.raises(InputError, match=r"^AC\d+(-2)?, cycle 60: action is 9 \(allowed: whole"):
        controller.transmit(world)
