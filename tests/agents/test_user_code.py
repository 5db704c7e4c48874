"""Controllers written by users: what they are given, and what their mistakes give."""

import jax
import numpy as np
import pytest

from skystack.agents.callsigns import Callsigns
from skystack.agents.user_code import IN_BLUEBIRD, UserController
from skystack.errors import InputError
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import ticks
from skystack.stacking import NO_OP
from skystack.tasks.sector_control import ACTIONS
from skystack.tasks.sector_observation import NAMES
from tests.agents import user_controllers
from tests.tasks.sector_traffic import ALLOWED, BEGIN, OBSERVE, TASK, after


@pytest.fixture(scope="module")
def world():
    return jax.device_get(after(60, action=NO_OP).world)


def transmit(controller, world):
    """The transmissions of a new controller."""
    agent = UserController(lambda: controller, TASK)
    agent.begin(world)
    return agent.transmit(world)


def given(world):
    """What a controller is called with."""
    seen = []

    class Keeps:
        def generate_action(self, env, observation, info):
            seen.extend((env, observation, info))
            return {}

    assert transmit(Keeps, world) == []
    return seen


@pytest.mark.slow
def test_it_is_given_the_flights_that_hear_it(world):
    env, observation, info = given(world)
    slots = Callsigns().follow(world)
    hearing = [name for name, slot in slots.items() if world.hears[slot]]
    assert list(observation) == list(info["action_mask"]) == hearing
    assert len(observation) == len(hearing)
    assert set(info["simulator_environment"].aircraft) == set(slots)
    assert info["sim_time"] == info["simulator_environment"].time == 360.0
    state = BEGIN(world)
    rows, masks = np.asarray(OBSERVE(state)), np.asarray(ALLOWED(state))
    for name in hearing:
        assert observation[name].shape == (len(NAMES),)
        np.testing.assert_allclose(observation[name], rows[:, slots[name]], atol=1e-6)
        np.testing.assert_array_equal(info["action_mask"][name], masks[:, slots[name]])
    assert env.sector.name == "x-plus"


def test_flights_are_described_as_in_bluebird(world):
    _, _, info = given(world)
    for name, slot in Callsigns().follow(world).items():
        flight, traffic = info["simulator_environment"].aircraft[name], world.traffic
        place = TASK.sector.plane.to_plane(flight.lat, flight.lon)
        np.testing.assert_allclose(place, traffic.position_nm[slot], atol=1e-4)
        assert flight.callsign == name
        assert flight.fl == pytest.approx(float(traffic.level_ticks[slot]) / TICKS_PER_FL)
        assert 0.0 <= flight.heading < 360.0
        filed = TASK.sector.routes[int(traffic.route[slot])]
        assert flight.flight_plan.route.filed == tuple(filed)
        assert flight.flight_plan.route.current[0] == filed[int(world.progress.next_fix[slot])]
        leaves = float(world.plan.exit_level_ticks[slot]) / TICKS_PER_FL
        assert flight.flight_plan.exit_fl == pytest.approx(leaves)


def test_the_airspeed_does_not_depend_on_the_rate_of_climb(world):
    """The ground speed does: it is 0.1 to 0.2 % lower in a climb."""
    traffic, model = world.traffic, TASK.simulator.performance
    climbing = traffic._replace(
        flown_level_ticks=traffic.level_ticks + ticks(20.0),
        ground_speed_kt=traffic.ground_speed_kt - np.float32(0.5),
    )
    _, _, info = given(world._replace(traffic=climbing))
    for name, slot in Callsigns().follow(world).items():
        expected = model.airspeed_kt * float(traffic.airspeed_factor[slot])
        found = info["simulator_environment"].aircraft[name].speed_tas
        assert found == pytest.approx(expected, rel=1e-6)


def test_the_parser_names_the_actions_as_bluebird_does():
    """The names in BluebirdDT's form mean the same as those of the task."""
    assert len(IN_BLUEBIRD) == len(ACTIONS)
    assert dict(zip(ACTIONS, IN_BLUEBIRD, strict=True)) == {
        "none": "action_noop",
        "turn -10 deg": "simple_heading_left__10",
        "turn +10 deg": "simple_heading_right__10",
        "climb 10 FL": "simple_fl_climb__10",
        "descend 10 FL": "simple_fl_descent__10",
        "direct": "route_direct_to",
    }


def test_a_controller_of_the_notebook_works(world):
    """It turns every flight north of the equator to the left."""
    sent = transmit(user_controllers.Notebook, world)
    north = world.traffic.position_nm[:, 1] > 0.0
    assert sorted(each.slot for each in sent) == np.flatnonzero(world.hears & north).tolist()
    for each in sent:
        cleared = float(world.traffic.cleared_heading_deg[each.slot])
        assert each.heading_deg == round(cleared - 10.0) % 360


def test_a_list_of_actions_is_one_transmission(world):
    for each in transmit(user_controllers.Bursts, world):
        cleared_fl = float(world.traffic.cleared_level_ticks[each.slot]) / TICKS_PER_FL
        expected_fl = min(cleared_fl + 20.0, 400.0)
        assert each.level_ticks == pytest.approx(expected_fl * TICKS_PER_FL)


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (user_controllers.Raises, r"cycle 60, generate_action failed: ValueError: two lines"),
        (user_controllers.Raises, r"\(user_controllers.py, line \d+\)$"),
        (user_controllers.NoSuchAction, r"cycle 60, AC\S+: action is 6 \(allowed: whole numbers"),
        (user_controllers.NoSuchFlight, r"cycle 60, BAW12: unknown callsign"),
        (user_controllers.Lists, r"cycle 60, generate_action returned list \(allowed: a dict"),
        (user_controllers.NeedsAnArgument, r"cannot create an instance: TypeError: .*argument"),
    ],
)
def test_mistakes_name_cycle_and_flight(world, controller, message):
    with pytest.raises(InputError, match=message) as caught:
        transmit(controller, world)
    assert "\n" not in str(caught.value)


def test_a_flight_that_has_left_cannot_be_addressed(world):
    agent = UserController(lambda: user_controllers.Everybody, TASK)
    agent.begin(world)
    agent.transmit(world)
    slot = int(np.flatnonzero(world.hears)[0])
    flight, active = np.array(world.arrivals.flight), np.array(world.traffic.active)
    flight[slot], active[slot] = -1, False
    gone = world._replace(
        arrivals=world.arrivals._replace(flight=flight),
        traffic=world.traffic._replace(active=active),
    )
    with pytest.raises(InputError, match=r"cycle 60, AC\S+: the flight has left$"):
        agent.transmit(gone)


def test_it_is_made_anew_for_every_hour(world):
    made = []

    class Counts(user_controllers.Nobody):
        def __init__(self):
            made.append(self)

    agent = UserController(lambda: Counts, TASK)
    for _ in range(2):
        agent.begin(world)
        agent.transmit(world)
    assert len(made) == 2


def test_what_it_prints_goes_to_standard_error(world, capsys):
    assert transmit(user_controllers.Prints, world) == []
    out, err = capsys.readouterr()
    assert (out, err) == ("", "thinking\n")


@pytest.mark.parametrize("answer", [{3: 0}, {"AC1": 10**5000}, {"AC1": [0] * 41}, {"AC1": "0"}])
def test_answers_that_cannot_be_read_are_input_errors(world, answer):
    class Answers:
        def generate_action(self, env, observation, info):
            first = next(iter(observation))
            return {first if key == "AC1" else key: value for key, value in answer.items()}

    with pytest.raises(InputError, match=r"^cycle 60, "):
        transmit(Answers, world)


def test_changes_to_what_it_was_given_do_not_last(world):
    class Deletes:
        def generate_action(self, env, observation, info):
            del env.actions["none"]
            return {}

    agent = UserController(lambda: Deletes, TASK)
    for _ in range(2):
        agent.begin(world)
        assert agent.transmit(world) == []
