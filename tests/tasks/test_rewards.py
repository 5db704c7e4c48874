"""Every reward at its limits, against the paper's formulas."""

import math

import jax.numpy as jnp
import pytest

from skystack.tasks import rewards


@pytest.mark.parametrize(
    ("distance_nm", "expected"),
    [(0.0, 0.0), (6.0, math.exp(-1) - 1), (-6.0, math.exp(-1) - 1), (10.0, math.exp(-25 / 9) - 1)],
)
def test_centreline(distance_nm, expected):
    assert float(rewards.centreline(jnp.asarray(distance_nm))) == pytest.approx(expected, abs=1e-6)


def test_centreline_far_away_costs_one():
    assert float(rewards.centreline(jnp.asarray(100.0))) == -1.0


@pytest.mark.parametrize(
    ("cycles", "expected"), [(0.0, -1.0), (1.0, -0.9), (9.0, -0.1), (10.0, 0.0), (11.0, 0.0)]
)
def test_damping(cycles, expected):
    assert float(rewards.damping(jnp.asarray(cycles))) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("distance_nm", "closest_nm", "expected"),
    [
        (0.0, 0.0, -1.0),
        (75.0, 0.0, -0.5),
        (75.0, 5.0, -0.5 * math.exp(-1)),
        (30.0, 10.0, -0.8 * math.exp(-4)),
        (150.0, 0.0, 0.0),
        (200.0, 0.0, 0.0),
    ],
)
def test_safety(distance_nm, closest_nm, expected):
    reward = rewards.safety(jnp.float32(distance_nm), jnp.float32(closest_nm), 150.0)
    assert float(reward) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("gap_fl", "expected"),
    [(0, 0.0), (40, math.exp(-1) - 1), (-40, math.exp(-1) - 1), (200, math.exp(-5) - 1)],
)
def test_vertical(gap_fl, expected):
    assert float(rewards.vertical(jnp.float32(gap_fl))) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("distance_nm", "expected"), [(4.9, 0.0), (-5.0, 0.0), (-7.5, -2.5)])
def test_outside_band(distance_nm, expected):
    assert float(rewards.outside_band(jnp.asarray(distance_nm), 5.0)) == pytest.approx(expected)


@pytest.mark.parametrize("satisfied", [0, 1, 2])
def test_each_criterion_alone_is_worth_five(satisfied):
    criteria = jnp.zeros((3, 2), dtype=bool).at[satisfied].set(True)
    assert float(rewards.terminal(criteria)) == 5.0


def test_a_criterion_met_by_one_of_two_aircraft_is_worth_half():
    criteria = jnp.zeros((3, 2), dtype=bool).at[0, 1].set(True)
    assert float(rewards.terminal(criteria)) == 2.5


def test_three_criteria_are_worth_15_plus_a_bonus_of_20():
    assert float(rewards.terminal(jnp.ones((3, 2), dtype=bool))) == 35.0


def test_two_criteria_are_worth_10_plus_a_bonus_of_20():
    assert float(rewards.terminal(jnp.ones((2, 2), dtype=bool))) == 30.0


def test_one_aircraft_missing_one_criterion_forfeits_the_bonus():
    criteria = jnp.ones((3, 2), dtype=bool).at[2, 0].set(False)
    assert float(rewards.terminal(criteria)) == 12.5


def test_scenarios_of_a_batch_are_rewarded_independently():
    criteria = jnp.ones((3, 2, 4), dtype=bool).at[:, :, 1].set(False).at[0, 1, 2].set(False)
    assert rewards.terminal(criteria).tolist() == [35.0, 0.0, 12.5, 35.0]
