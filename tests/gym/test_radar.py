"""The radar picture: who is drawn where, with which figures, and how long the trail is."""

import jax
import numpy as np
import pytest

from skystack.gym import radar
from skystack.gym.environment import TaskEnvironment
from skystack.gym.vector import VectorTaskEnvironment
from skystack.reporting.radar import colour_of
from tests.gym.counting import Visible


@pytest.fixture
def drawn(monkeypatch):
    """What is drawn instead of a picture: routes and trails, and aircraft, with their colours."""
    ways, aircraft = [], []
    monkeypatch.setattr(radar, "draw_way", lambda axes, *what: ways.append(what))
    monkeypatch.setattr(radar, "draw_aircraft", lambda axes, *what: aircraft.append(what))
    return ways, aircraft


def clock(environment):
    return environment._radar.screen._axes.get_title(loc="left")


def test_every_aircraft_is_drawn_with_its_own_figures(drawn):
    ways, aircraft = drawn
    environment = TaskEnvironment(Visible(), "rgb_array")
    environment.reset(seed=0)
    environment.step(1)
    environment.render()
    sector = environment.task.sector
    for number, (route_nm, _, colour) in enumerate(ways):
        route = sector.routes[(3, 1, 2)[number]]
        np.testing.assert_array_equal(route_nm, sector.path_nm(route))
        assert colour == colour_of(number)
    assert len(ways) == 3
    (first, colour), (second, other) = aircraft  # the third has left
    assert (colour, other) == (colour_of(0), colour_of(1))
    assert first.position_nm.tolist() == [1.0, 10.0]
    assert first[:1] + first[2:-1] == ("AC1", 90.0, 120.0, 420.0, 290.0, 300.0)
    assert second.position_nm.tolist() == [-1.0, -20.0]
    assert second[:1] + second[2:-1] == ("AC2", 270.0, 200.0, 480.0, 310.0, 280.0)
    # The plane's scale is 1 at the origin and cosh(y / R) nearly, R = 3438 NM.
    assert [each.scale - 1.0 for each in (first, second)] == pytest.approx(
        [np.cosh(north / 3438.0) - 1.0 for north in (10.0, 20.0)], rel=0.02
    )


def test_trails_and_the_clock_follow_the_flight_and_begin_anew(drawn):
    ways, _ = drawn

    def trails():
        ways.clear()
        environment.render()
        return [trail_nm[:, 0].tolist() for _, trail_nm, _ in ways]

    environment = TaskEnvironment(Visible(), "rgb_array")
    environment.reset(seed=0)
    assert trails() == [[0.0], [0.0], [5.0]]
    assert clock(environment) == "counting, minute 00:00"
    for _ in range(12):
        environment.step(0)
    assert trails() == [list(range(13)), [-east for east in range(13)], [5.0] * 13]
    assert clock(environment) == "counting, minute 01:12"
    environment.instruct(1)
    environment.render()
    assert clock(environment) == "counting, minute 01:12"
    environment.reset(seed=1)
    assert trails() == [[0.0], [0.0], [5.0]]


def test_each_scenario_of_many_has_its_own_trail(drawn):
    """A restarted one begins anew, on a screen that all have in common."""
    ways, _ = drawn
    environment = VectorTaskEnvironment(Visible(), 2, "Disabled", render_mode="rgb_array")
    environment.reset(seed=0)
    environment.step(np.zeros(2, dtype=int))
    environment.reset(options={"reset_mask": np.array([True, False])})
    environment.render()
    assert [trail_nm[:, 0].tolist() for _, trail_nm, _ in ways[::3]] == [[0.0], [0.0, 1.0]]
    assert environment._radars[0].screen is environment._radars[1].screen


def test_a_sweep_without_time_passed_adds_no_position(drawn):
    ways, _ = drawn
    task = Visible()
    state, screen = task.reset(jax.random.key(0)), radar.Radar(task)
    for _ in range(2):
        screen.sweep(state)
    screen.picture(state)
    assert [len(trail_nm) for _, trail_nm, _ in ways] == [1, 1, 1]


def test_colours_are_red_green_and_blue_in_this_order(drawn):
    environment = TaskEnvironment(Visible(), "rgb_array")
    environment.reset(seed=0)
    picture = environment.render()
    assert (picture.shape, picture.dtype) == ((680, 720, 3), np.uint8)
    assert picture[0, 0].tolist() == [255, 255, 255]
    area = np.array([0xEE, 0xF2, 0xF5])
    assert np.mean(np.all(picture == area, axis=2)) > 0.05
