"""The reward of a cycle: every term with its own weight, recomputed in numpy from the paper."""

from itertools import combinations
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.navigation import NavigationState
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

from .conftest import REVERSED, STRAIGHT, TURNING
from .memories import with_fields

WEIGHTS = RewardSettings(
    centreline=1.5,
    damping=0.25,
    terminal=2.0,
    safety=3.0,
    vertical=0.7,
    burst=0.6,
    leg=0.4,
    shared_damping=0.35,
    outside_band=0.11,
    band_nm=2.0,
    excursion=4.0,
    conflict=0.9,
    conflict_nm=8.0,
)
ROUTES = (STRAIGHT, REVERSED, TURNING)
ALONG_NM = (20.0, 60.0, 14.0)
RIGHT_NM = (7.0, -1.0, 3.0)
"""The positions of the aircraft along the first leg of the route, and to the right of it."""
SPEED_KT = (480.0, 420.0, 300.0)
CLEARED_FL, EXIT_FL = (300.0, 320.0, 300.0), (300.0, 300.0, 360.0)
WAITED_CYCLES = (10.0, 3.0, 9.0)
"""Cycles since the last instruction, before the rewarded cycle."""


class CycleEnds(NamedTuple):
    """Ends cycles of a task with traffic that the task has not flown itself."""

    task: Any
    end: Any
    """Compiled: the state and outcome from the memory and the flown traffic."""

    def reward(self, memory, flown):
        return float(self.end(memory, flown)[1].reward[0])


def cycle_ends_of(task):
    return CycleEnds(
        task, jax.jit(lambda memory, flown: task.end_cycle(NavigationState(flown, memory), flown))
    )


@pytest.fixture(scope="module")
def cycle():
    return cycle_ends_of(
        build_task(NavigationSettings(name="avoidance", aircraft=3, reward=WEIGHTS))
    )


@pytest.fixture(scope="module")
def flown(cycle, traffic_on) -> Traffic:
    """Three aircraft inside the sector, each beside the first leg of its route."""
    sector, positions, headings = cycle.task.sector, [], []
    for route, along, right in zip(ROUTES, ALONG_NM, RIGHT_NM, strict=True):
        heading = sector.first_heading_deg(route)
        angle = np.radians(heading)
        ahead, beside = (
            np.array([np.sin(angle), np.cos(angle)]),
            np.array([np.cos(angle), -np.sin(angle)]),
        )
        positions.append(sector.fixes_nm[route[0]] + along * ahead + right * beside)
        headings.append(heading)
    traffic = traffic_on(*ROUTES, positions=positions, headings=headings)
    return traffic._replace(
        ground_speed_kt=jnp.asarray(SPEED_KT),
        cleared_level_ticks=jnp.asarray([ticks(fl) for fl in CLEARED_FL], dtype=jnp.float32),
    )


@pytest.fixture(scope="module")
def memory(cycle, flown):
    """No aircraft moves in the cycle, so that separations are distances."""
    exits = jnp.asarray([ticks(fl) for fl in EXIT_FL], dtype=jnp.float32)
    return with_fields(
        cycle.task.begin(flown, exits).memory, cycles_since_instruction=jnp.asarray(WAITED_CYCLES)
    )


def closest_nm(flown, one, other):
    """The closest of 100,001 positions on cleared headings, until the faster has flown 150 NM."""
    times_h = np.linspace(0.0, 150.0 / max(SPEED_KT[one], SPEED_KT[other]), 100_001)[:, None]
    angle = np.radians(np.asarray(flown.cleared_heading_deg, dtype=np.float64))
    velocity = np.asarray(SPEED_KT)[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    start = np.asarray(flown.position_nm, dtype=np.float64)
    gaps = start[other] - start[one] + times_h * (velocity[other] - velocity[one])
    return np.linalg.norm(gaps, axis=1).min()


def expected_of_aircraft(number, waited, excursion=False):
    """The terms of one aircraft: equations (centreline), (sparse_action), (eq:vertical_reward)."""
    distance, gap_fl = RIGHT_NM[number], CLEARED_FL[number] - EXIT_FL[number]
    return (
        (1.5 + 0.4) * (np.exp(-((distance / 6.0) ** 2)) - 1.0)  # all are beside the first leg
        + 0.25 * (waited / 10.0 - 1.0)
        - 0.11 * max(abs(distance) - 2.0, 0.0)
        - 4.0 * excursion
        + 0.7 * (np.exp(-abs(gap_fl) / 40.0) - 1.0)
    )


def expected_of_pairs(flown, present):
    """Equation (eq:safety_reward) of the worst pair, and the depth of the nearest inside 8 NM."""
    position = np.asarray(flown.position_nm, dtype=np.float64)
    worst, nearest = 0.0, np.inf
    for one, other in combinations(present, 2):
        distance = np.linalg.norm(position[one] - position[other])
        closest = closest_nm(flown, one, other)
        worst = min(worst, (distance / 150.0 - 1.0) * np.exp(-((closest / 5.0) ** 2)))
        nearest = min(nearest, distance)
    return 3.0 * worst - 0.9 * max(8.0 - nearest, 0.0)


@pytest.mark.parametrize("present", [(0, 1, 2), (0, 1), (0, 2), (1,)])
def test_reward_is_the_weighted_sum_of_its_terms(cycle, flown, memory, present):
    """Averaged over all three aircraft. Exited aircraft cost nothing and are no threat."""
    active = jnp.asarray([number in present for number in range(3)])
    each = [
        expected_of_aircraft(number, WAITED_CYCLES[number] + (number != 0)) for number in present
    ]
    waited = min(WAITED_CYCLES[number] + (number != 0) for number in present)
    shared = 0.35 * (waited / 10.0 - 1.0)
    assert cycle.reward(memory, flown._replace(active=active)) == pytest.approx(
        sum(each) / 3.0 + shared + expected_of_pairs(flown, present), abs=2e-4
    )


def test_bursts_and_instructions_of_the_cycle_cost(cycle, flown, memory):
    before = cycle.reward(memory, flown)
    instructed = with_fields(
        memory, new_bursts=jnp.float32(2.0), instructed=jnp.asarray([False, True, False])
    )
    # Aircraft 2 had waited four cycles including this one; now it has waited none. Nobody had
    # waited less, so the shared counter falls by as much.
    assert cycle.reward(instructed, flown) - before == pytest.approx(
        -0.6 * 2.0 - 0.25 * 0.4 / 3 - 0.35 * 0.4, abs=1e-5
    )


def test_an_excursion_costs_only_when_it_happens(cycle, flown, memory):
    far = flown._replace(position_nm=flown.position_nm.at[1].set(jnp.asarray([300.0, 0.0])))
    inside = with_fields(memory, entered=jnp.asarray([True, True, True]))
    never = with_fields(memory, entered=jnp.asarray([True, False, True]))
    already = with_fields(inside, excursion=jnp.asarray([False, True, False]))
    now, later = cycle.reward(inside, far), cycle.reward(already, far)
    assert now - later == pytest.approx(-4.0 / 3.0, abs=1e-5)
    assert cycle.reward(never, far) == later


def test_scenarios_of_a_batch_are_rewarded_independently(cycle, flown, memory):
    """With a last axis for the batch. Two scenarios end, one for both reasons; two continue."""
    alone = flown._replace(active=jnp.asarray([False, True, False]))
    exited = flown._replace(active=jnp.zeros(3, dtype=bool))
    late = with_fields(memory, cycles=jnp.float32(299.0), entered=jnp.asarray([True, False, True]))
    late = with_fields(late, instructions=jnp.asarray([1.0, 2.0, 30.0]), bursts=jnp.float32(5.0))
    cases = [(memory, flown), (late, flown), (memory, alone), (late, exited)]
    _, outcome = cycle.end(*jax.tree.map(lambda *rows: jnp.stack(rows, axis=-1), *cases))
    np.testing.assert_allclose(
        outcome.reward[0], [cycle.reward(*case) for case in cases], rtol=0.0, atol=1e-4
    )
    assert outcome.ended.tolist() == [False, True, False, True]
    metrics = outcome.metrics
    assert metrics["instructions"].tolist() == [0.0, 33.0, 0.0, 33.0]
    assert metrics["bursts"].tolist() == [0.0, 5.0, 0.0, 5.0]
    assert metrics["few_instructions"].tolist() == [True, False, True, False]
    assert metrics["cycles"].tolist() == [1.0, 300.0, 1.0, 300.0]
    # The second aircraft has just entered; in the last scenario it never can.
    assert metrics["excursion"].tolist() == [False, False, False, True]
    assert np.isfinite(metrics["min_separation_nm"]).tolist() == [True, True, False, False]


def test_a_single_aircraft_has_no_safety_cost(traffic_on):
    """On the centreline, without instructions and pairs, the reward is zero."""
    task = build_task(
        NavigationSettings(name="avoidance", aircraft=1, reward=RewardSettings(safety=3.0))
    )
    state = task.begin(traffic_on(STRAIGHT))
    assert cycle_ends_of(task).reward(*state[::-1]) == pytest.approx(0.0, abs=1e-4)


FEW, MANY = (29.0, 0.0, 29.0), (0.0, 30.0, 0.0)


@pytest.mark.parametrize(
    ("correct", "excursion", "instructions", "expected"),
    [
        ((True, True, True), (False, False, False), FEW, 35.0),
        ((True, True, False), (False, False, False), FEW, 5.0 + 10.0 / 3 + 5.0),
        ((True, True, True), (True, False, True), FEW, 5.0 + 5.0 / 3 + 5.0),
        ((True, True, True), (False, False, False), MANY, 5.0 + 5.0 + 10.0 / 3),
        ((False, False, False), (True, True, True), (30.0, 31.0, 30.0), 0.0),
    ],
    ids=["all met", "a wrong exit", "excursions", "many instructions", "none met"],
)
@pytest.mark.parametrize("cycles", [298.0, 299.0, 300.0])
def test_terminal_rewards_are_given_at_the_end(
    cycle, flown, memory, cycles, correct, excursion, instructions, expected
):
    state = with_fields(
        memory,
        entered=jnp.asarray([True, True, True]),
        exited_correctly=jnp.asarray(correct),
        excursion=jnp.asarray(excursion),
        instructions=jnp.asarray(instructions),
    )
    before_end = cycle.reward(state, flown)
    _, outcome = cycle.end(with_fields(state, cycles=jnp.float32(cycles)), flown)
    assert bool(outcome.ended) == (cycles >= 299.0)
    assert not bool(outcome.truncated)
    assert float(outcome.reward[0]) - before_end == pytest.approx(
        2.0 * expected * (cycles >= 299.0), abs=1e-4
    )
    assert bool(outcome.metrics["success"]) == (expected == 35.0)
    assert bool(outcome.metrics["correct_exit"]) == all(correct)
    assert bool(outcome.metrics["excursion"]) == any(excursion)
    assert bool(outcome.metrics["few_instructions"]) == (instructions == FEW)


def test_a_scenario_ends_when_no_aircraft_is_left(cycle, flown, memory):
    """No aircraft entered, so only the count criterion is met."""
    exited = flown._replace(active=jnp.zeros(3, dtype=bool))
    outside = with_fields(memory, entered=jnp.asarray([False, False, False]))
    state, outcome = cycle.end(outside, exited)
    assert bool(outcome.ended)
    assert np.all(state.memory.progress.excursion)
    assert float(outcome.reward[0]) == pytest.approx(2.0 * 5.0)
    entered = with_fields(memory, entered=jnp.asarray([True, False, True]))
    np.testing.assert_array_equal(
        cycle.end(entered, exited)[0].memory.progress.excursion, [False, True, False]
    )
