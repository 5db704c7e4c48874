"""Turns: 1.5 degrees per second, in the cleared direction, exact at the end, and their path."""

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.simulator import turn_to_deg
from skystack.simulator.traffic import LEFT, RIGHT, SHORTEST

from .flights import MODELS, TimedClearance, angle_between_deg, flights

ORIGIN = np.zeros((1, 2))


def headings(start_deg, clearances, cycles, model="constant"):
    """Headings `[row, aircraft]` of aircraft that all start at the origin."""
    start_deg = np.atleast_1d(start_deg)
    simulation = flights(model)
    traffic = simulation.start(np.zeros((len(start_deg), 2)), start_deg)
    return simulation.fly(traffic, cycles, clearances).heading_deg


def total_turn_deg(rows):
    """The total turn, positive to the right. Each step is far below half a turn."""
    return np.sum((np.diff(rows.astype(float), axis=0) + 180.0) % 360.0 - 180.0, axis=0)


@pytest.mark.parametrize("target", [0, 1, 37, 180, 271, 359])
def test_every_turn_follows_its_closed_form(target):
    """9 degrees per cycle from row 1, the shorter way, to exactly the target."""
    start = np.arange(0.0, 360.0, 1.5) + np.linspace(0.0, 1.0, 240)
    rows = headings(
        start, [TimedClearance(0, a, heading_deg=target) for a in range(len(start))], 23
    )
    turn = (target - start + 180.0) % 360.0 - 180.0
    turn = np.where((turn == -180.0) & (target > start), 180.0, turn)
    for row in range(1, 24):
        turned = np.sign(turn) * np.minimum(9.0 * (row - 1), np.abs(turn))
        assert np.max(angle_between_deg(rows[row], start + turned)) < 1e-3
        done = np.abs(turn) < 9.0 * (row - 1) - 1e-3
        assert (rows[row][done] == target).all()
    assert (rows[-1] == target).all()
    assert ((rows >= 0.0) & (rows < 360.0)).all()


@pytest.mark.parametrize(
    ("start", "target", "turn", "expected"),
    [
        (45.0, 55, SHORTEST, 10.0),
        (45.0, 35, SHORTEST, -10.0),
        (10.0, 350, SHORTEST, -20.0),
        (350.0, 10, SHORTEST, 20.0),
        (45.0, 205, LEFT, -200.0),
        (45.0, 205, RIGHT, 160.0),
        (45.0, 35, RIGHT, 350.0),
        (45.0, 55, LEFT, -350.0),
        (325.0, 315, LEFT, -10.0),
        (315.0, 325, RIGHT, 10.0),
        (324.0, 325, RIGHT, 1.0),
        # Half a turn does not pass through north: left from above the target, otherwise right.
        (45.0, 225, SHORTEST, 180.0),
        (225.0, 45, SHORTEST, -180.0),
        (0.0, 180, SHORTEST, 180.0),
        (180.0, 0, SHORTEST, -180.0),
        (45.0, 225, LEFT, -180.0),
        (225.0, 45, RIGHT, 180.0),
        (90.0, 90, LEFT, 0.0),
        (90.0, 90, RIGHT, 0.0),
    ],
)
def test_direction_of_a_turn(start, target, turn, expected):
    rows = headings(start, [TimedClearance(0, 0, heading_deg=target, turn=turn)], 45)
    assert total_turn_deg(rows)[0] == pytest.approx(expected, abs=1e-3)
    assert rows[-1, 0] == target


def test_turn_to_deg_is_the_shorter_turn():
    start, target = np.meshgrid(np.arange(0.0, 360.0, 5.0), np.arange(0.0, 360.0, 5.0))
    got = turn_to_deg(jnp.asarray(start, jnp.float32), jnp.asarray(target, jnp.float32))
    got = np.asarray(got)
    half = np.abs(target - start) == 180.0
    shorter = (target - start + 180.0) % 360.0 - 180.0
    assert np.array_equal(got[~half], shorter[~half])
    assert np.array_equal(got[half], np.where(target > start, 180.0, -180.0)[half])


def test_a_clearance_takes_effect_one_cycle_later():
    simulation = flights("constant")
    traffic = simulation.start(ORIGIN, 45.0)
    cleared = simulation.fly(traffic, 8, [TimedClearance(2, 0, heading_deg=75, fl=320)])
    straight = simulation.fly(traffic, 8)
    for name in ("position_nm", "heading_deg", "level_ticks", "ground_speed_kt"):
        changed, unchanged = getattr(cleared, name), getattr(straight, name)
        assert np.array_equal(changed[:4], unchanged[:4])
        assert not np.array_equal(changed[4], unchanged[4])
    assert cleared.cleared_heading_deg[:4, 0].tolist() == [45.0, 45.0, 45.0, 75.0]
    headings_deg = [45.0, 45.0, 45.0, 45.0, 54.0, 63.0, 72.0, 75.0, 75.0]
    assert cleared.heading_deg[:, 0].tolist() == headings_deg
    assert (cleared.level_ticks[:, 0] / 6000.0).tolist() == [
        300,
        300,
        300,
        300,
        302,
        304,
        306,
        308,
        310,
    ]


def test_a_new_heading_is_turned_to_from_the_current_one():
    """Turning right from 0 to 180, it is at 54 when 200 is adopted, and continues to the right. At
    108 it adopts 300, to which the shorter way is to the left."""
    clearances = [
        TimedClearance(0, 0, heading_deg=180, turn=RIGHT),
        TimedClearance(6, 0, heading_deg=200),
        TimedClearance(12, 0, heading_deg=300),
    ]
    rows = headings(0.0, clearances, 60)[:, 0]
    assert rows[:8].tolist() == [0.0, 0.0, 9.0, 18.0, 27.0, 36.0, 45.0, 54.0]
    assert rows[8:14].tolist() == [63.0, 72.0, 81.0, 90.0, 99.0, 108.0]
    assert rows[14:17].tolist() == [99.0, 90.0, 81.0]
    assert rows[-1] == 300.0


def test_repeating_a_heading_changes_nothing():
    once = headings(10.0, [TimedClearance(0, 0, heading_deg=100)], 20)
    often = headings(10.0, [TimedClearance(k, 0, heading_deg=100) for k in range(15)], 20)
    assert often == pytest.approx(once, abs=1e-4)


def test_a_heading_without_direction_is_turned_the_shorter_way():
    """Turning right from 0 to 270, it is at 45 when it adopts 270 without a direction."""
    clearances = [
        TimedClearance(0, 0, heading_deg=270, turn=RIGHT),
        TimedClearance(5, 0, heading_deg=270),
    ]
    rows = headings(0.0, clearances, 40)
    assert total_turn_deg(rows)[0] == pytest.approx(-90.0, abs=1e-3)
    assert np.max(rows[:7]) == 45.0


@pytest.mark.parametrize(("model", "radius_nm"), [("constant", 4.2441), ("table", 4.9438)])
@pytest.mark.parametrize("turn", [LEFT, RIGHT])
def test_radius_of_a_turn(model, radius_nm, turn):
    """Half a turn from heading north ends two radii to the side."""
    simulation = flights(model)
    rows = simulation.fly(
        simulation.start(ORIGIN, 0.0), 22, [TimedClearance(0, 0, heading_deg=180, turn=turn)]
    )
    assert rows.heading_deg[20, 0] == pytest.approx(180.0 - 9.0 * (1 if turn == RIGHT else -1))
    side = 1.0 if turn == RIGHT else -1.0
    across, _ = rows.position_nm[21, 0] - rows.position_nm[1, 0]
    assert across == pytest.approx(2.0 * radius_nm * side, abs=1e-3)
    # After a quarter turn it is one radius ahead and one to the side.
    quarter = rows.position_nm[11, 0] - rows.position_nm[1, 0]
    assert quarter == pytest.approx((radius_nm * side, radius_nm), abs=1e-3)


@pytest.mark.parametrize(("model", "speed_kt"), [("constant", 400.0), ("table", 465.940793)])
def test_straight_flight(model, speed_kt):
    start = np.arange(0.0, 360.0, 1.5)
    simulation = flights(model)
    end = simulation.fly(simulation.start(np.zeros((240, 2)), start), 10).position_nm[-1]
    flown = speed_kt / 60.0
    expected = flown * np.stack([np.sin(np.radians(start)), np.cos(np.radians(start))], axis=1)
    assert end == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_each_second_of_a_turn_flies_its_midpoint_heading(model):
    """A turn of 9 degrees in a cycle has six chords, the first 0.75 degrees off the old heading."""
    simulation = flights(model)
    rows = simulation.fly(simulation.start(ORIGIN, 0.0), 2, [TimedClearance(0, 0, heading_deg=9)])
    chord = rows.ground_speed_kt[0, 0] / 3600.0
    along = np.radians(0.75 + 1.5 * np.arange(6))
    expected = chord * np.array([np.sin(along).sum(), np.cos(along).sum()])
    assert rows.position_nm[2, 0] - rows.position_nm[1, 0] == pytest.approx(expected, abs=2e-6)


def test_the_last_second_of_a_turn_flies_its_midpoint_heading():
    """10 degrees take seven seconds, with one degree in the last."""
    simulation = flights("constant")
    rows = simulation.fly(simulation.start(ORIGIN, 0.0), 3, [TimedClearance(0, 0, heading_deg=10)])
    along = np.radians([9.5, 10.0, 10.0, 10.0, 10.0, 10.0])
    expected = 400.0 / 3600.0 * np.array([np.sin(along).sum(), np.cos(along).sum()])
    assert rows.position_nm[3, 0] - rows.position_nm[2, 0] == pytest.approx(expected, abs=2e-6)
