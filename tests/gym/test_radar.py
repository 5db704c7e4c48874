"""The radar picture: positions and labels of the aircraft, and their trails."""

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
    """Record, instead of drawing, the routes with their trails, and the aircraft."""
    tracks, aircraft = [], []
    monkeypatch.setattr(radar, "draw_route_and_trail", lambda axes, *values: tracks.append(values))
    monkeypatch.setattr(radar, "draw_aircraft", lambda axes, *values: aircraft.append(values))
    return tracks, aircraft


def clock(environment):
    return environment._radar.screen._axes.get_title(loc="left")


def test_draws_every_aircraft_with_its_own_values(drawn):
    tracks, aircraft = drawn
    environment = TaskEnvironment(Visible(), "rgb_array")
    environment.reset(seed=0)
    environment.step(1)
    environment.render()
    sector = environment.task.sector
    for number, (route_nm, _, colour) in enumerate(tracks):
        route = sector.routes[(3, 1, 2)[number]]
        np.testing.assert_array_equal(route_nm, sector.path_nm(route))
        assert colour == colour_of(number)
    assert len(tracks) == 3
    (first, colour), (second, other) = aircraft  # the third aircraft has left
    assert (colour, other) == (colour_of(0), colour_of(1))
    assert first.position_nm.tolist() == [1.0, 10.0]
    assert first[:1] + first[2:-1] == ("AC1", 90.0, 120.0, 420.0, 290.0, 300.0)
    assert second.position_nm.tolist() == [-1.0, -20.0]
    assert second[:1] + second[2:-1] == ("AC2", 270.0, 200.0, 480.0, 310.0, 280.0)
    # The scale of the projection is 1 at the origin, and about cosh(y / R) with R = 3438 NM.
    assert [each.scale - 1.0 for each in (first, second)] == pytest.approx(
        [np.cosh(north / 3438.0) - 1.0 for north in (10.0, 20.0)], rel=0.02
    )


def test_reset_restarts_trails_and_clock(drawn):
    tracks, _ = drawn

    def trails():
        tracks.clear()
        environment.render()
        return [trail_nm[:, 0].tolist() for _, trail_nm, _ in tracks]

    environment = TaskEnvironment(Visible(), "rgb_array")
    environment.reset(seed=0)
    assert trails() == [[0.0], [0.0], [5.0]]
    assert clock(environment) == "counting, time 00:00"
    for _ in range(12):
        environment.step(0)
    assert trails() == [list(range(13)), [-east for east in range(13)], [5.0] * 13]
    assert clock(environment) == "counting, time 01:12"
    environment.instruct(1)
    environment.render()
    assert clock(environment) == "counting, time 01:12"
    environment.reset(seed=1)
    assert trails() == [[0.0], [0.0], [5.0]]


def test_each_scenario_has_its_own_trail(drawn):
    """The trail of a restarted scenario starts again; all scenarios share one screen."""
    tracks, _ = drawn
    environment = VectorTaskEnvironment(Visible(), 2, "Disabled", render_mode="rgb_array")
    environment.reset(seed=0)
    environment.step(np.zeros(2, dtype=int))
    environment.reset(options={"reset_mask": np.array([True, False])})
    environment.render()
    assert [trail_nm[:, 0].tolist() for _, trail_nm, _ in tracks[::3]] == [[0.0], [0.0, 1.0]]
    assert environment._radars[0].screen is environment._radars[1].screen


def test_sweep_without_elapsed_time_adds_no_position(drawn):
    tracks, _ = drawn
    task = Visible()
    state, screen = task.reset(jax.random.key(0)), radar.Radar(task)
    for _ in range(2):
        screen.sweep(state)
    screen.picture(state)
    assert [len(trail_nm) for _, trail_nm, _ in tracks] == [1, 1, 1]


def test_picture_is_rgb(drawn):
    environment = TaskEnvironment(Visible(), "rgb_array")
    environment.reset(seed=0)
    picture = environment.render()
    assert (picture.shape, picture.dtype) == ((680, 720, 3), np.uint8)
    assert picture[0, 0].tolist() == [255, 255, 255]
    area = np.array([0xEE, 0xF2, 0xF5])
    assert np.mean(np.all(picture == area, axis=2)) > 0.05
