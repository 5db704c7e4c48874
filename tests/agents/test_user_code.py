"""Controllers written by users: what they are given, and what their mistakes give."""

import importlib
import sys

import jax
import numpy as np
import pytest

from skystack.agents.callsigns import Callsigns
from skystack.agents.user_code import (
    IN_BLUEBIRD,
    UserController,
    find_user_code,
    is_user_code,
    user_code_file,
)
from skystack.errors import InputError
from skystack.simulator.performance import TICKS_PER_FL
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


@pytest.mark.parametrize(
    ("name", "is_code"),
    [
        ("mine:Mine", True),
        ("a.b:Mine", True),
        ("folder/mine.py:Mine", True),
        ("search", False),
        (":Mine", False),
        ("mine:", False),
        ("runs/a:b/policy", False),
        ("model.onnx", False),
    ],
)
def test_names_of_classes(name, is_code):
    assert is_user_code(name) == is_code


def test_finds_a_class_in_a_module_or_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    source = (
        "class Mine:\n    def generate_action(self, env, observation, info):\n        return {}\n"
    )
    (tmp_path / "mine_here.py").write_text(source)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine_there.py").write_text(source)
    assert find_user_code("mine_here:Mine").__name__ == "Mine"
    assert find_user_code("other/mine_there.py:Mine")().generate_action(1, 2, 3) == {}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:Mine", "no_such_module:Mine: cannot be imported: ModuleNotFoundError"),
        ("no_such_file.py:Mine", "no_such_file.py:Mine: no_such_file.py does not exist or is not"),
        ("tests.agents.user_controllers:Mine", "there is no Mine in tests.agents.user_controllers"),
        ("tests.agents.user_controllers:Silent", "Silent is not a class with a method generate_"),
        ("tests.agents.user_controllers:os", "os is not a class with a method generate_action"),
    ],
)
def test_wrong_names_are_one_line(name, message):
    with pytest.raises(InputError, match=message):
        find_user_code(name)


def test_a_module_that_fails_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken_module.py").write_text("x = 1\nraise SystemExit('stop')\n")
    with pytest.raises(InputError, match=r"SystemExit: stop \(broken_module.py, line 2\)$"):
        find_user_code("broken_module:Mine")


def test_a_file_may_have_the_name_of_a_module(tmp_path, monkeypatch):
    """It is executed itself, and does not replace the module for anybody else."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    source = "class Mine:\n    def generate_action(self, *given):\n        return {}\n"
    for name in ("json.py", "my.agent.py", "queue.py"):
        (tmp_path / name).write_text(source)
        assert find_user_code(f"{tmp_path / name}:Mine").__name__ == "Mine"
    assert hasattr(importlib.import_module("json"), "JSONEncoder")
    assert sys.path[-1] == str(tmp_path)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("raise KeyboardInterrupt", r"KeyboardInterrupt \(bad_file.py, line 1\)$"),
        ("class Odd(BaseException): pass\nraise Odd('b')", r"Odd: b \(bad_file.py, line 2\)$"),
        (
            "class Mute(Exception):\n    def __str__(self):\n        raise ValueError\nraise Mute",
            r"Mute \(bad_file.py, line 4\)$",
        ),
        ("def __getattr__(name):\n    raise RuntimeError(name)", "RuntimeError: Mine"),
        ("Mine = 3", "Mine is not a class with a method generate_action"),
    ],
)
def test_files_that_fail_in_odd_ways_give_one_line(tmp_path, monkeypatch, source, message):
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "bad_file.py").write_text(source)
    with pytest.raises(InputError, match=message) as caught:
        find_user_code(f"{tmp_path / 'bad_file.py'}:Mine")
    assert "\n" not in str(caught.value)


def test_the_file_of_a_module_is_found_without_importing_it(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "not_imported.py").write_text("raise SystemExit(0)")
    assert user_code_file("not_imported:Mine") == tmp_path / "not_imported.py"
    assert user_code_file("not_imported.py:Mine").samefile(tmp_path / "not_imported.py")
    assert user_code_file("sys:Mine") is None
    for name in ("no_such_module:Mine", "no_such_file.py:Mine", "no.such.package:Mine"):
        with pytest.raises(InputError, match="no"):
            user_code_file(name)


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
