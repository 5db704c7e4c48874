"""What a cycle is paid: every term with a weight of its own, recomputed in numpy from the paper."""

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

from .conftest import BACK, STRAIGHT, TURNING
from .memories import changed

WEIGHTS = RewardSettings(
    centreline=1.5,
    damping=0.25,
    terminal=2.0,
    safety=3.0,
    vertical=0.7,
    burst=0.6,
    outside_band=0.11,
    band_nm=2.0,
    excursion=4.0,
    conflict=0.9,
    conflict_nm=8.0,
)
ROUTES = (STRAIGHT, BACK, TURNING)
ALONG_NM = (20.0, 60.0, 14.0)
RIGHT_NM = (7.0, -1.0, 3.0)
"""Where the aircraft are: after the first fix of the route, and to the right of it."""
SPEED_KT = (480.0, 420.0, 300.0)
CLEARED_FL, EXIT_FL = (300.0, 320.0, 300.0), (300.0, 300.0, 360.0)
WAITED = (10.0, 3.0, 9.0)
"""Cycles since the last instruction, before this one."""


class Cycles(NamedTuple):
    """Ends cycles of a task whose traffic was flown elsewhere."""

    task: Any
    end: Any
    """Compiled: memory and flown traffic to state and outcome."""

    def reward(self, memory, flown):
        return float(self.end(memory, flown)[1].reward[0])


def cycles_of(task):
    return Cycles(
        task, jax.jit(lambda memory, flown: task.end_cycle(NavigationState(flown, memory), flown))
    )


@pytest.fixture(scope="module")
def cycle():
    return cycles_of(build_task(NavigationSettings(name="avoidance", aircraft=3, reward=WEIGHTS)))


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
    there = traffic_on(*ROUTES, positions=positions, headings=headings)
    return there._replace(
        ground_speed_kt=jnp.asarray(SPEED_KT),
        cleared_level_ticks=jnp.asarray([ticks(fl) for fl in CLEARED_FL], dtype=jnp.float32),
    )


@pytest.fixture(scope="module")
def memory(cycle, flown):
    """Nobody moves in the cycle, so that separation is distance."""
    exits = jnp.asarray([ticks(fl) for fl in EXIT_FL], dtype=jnp.float32)
    return changed(
        cycle.task.begin(flown, exits).memory, cycles_since_instruction=jnp.asarray(WAITED)
    )


def closest_nm(flown, one, other):
    """Of two aircraft on their headings until the faster has flown 150 NM: a thousand moments."""
    times_h = np.linspace(0.0, 150.0 / max(SPEED_KT[one], SPEED_KT[other]), 100_001)[:, None]
    angle = np.radians(np.asarray(flown.cleared_heading_deg, dtype=np.float64))
    velocity = np.asarray(SPEED_KT)[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    start = np.asarray(flown.position_nm, dtype=np.float64)
    gaps = start[other] - start[one] + times_h * (velocity[other] - velocity[one])
    return np.linalg.norm(gaps, axis=1).min()


def expected_of_aircraft(number, waited, strays=False):
    """The terms of one aircraft: equations (centreline), (sparse_action), (eq:vertical_reward)."""
    distance, gap_fl = RIGHT_NM[number], CLEARED_FL[number] - EXIT_FL[number]
    return (
        1.5 * (np.exp(-((distance / 6.0) ** 2)) - 1.0)
        + 0.25 * (waited / 10.0 - 1.0)
        - 0.11 * max(abs(distance) - 2.0, 0.0)
        - 4.0 * strays
        + 0.7 * (np.exp(-abs(gap_fl) / 40.0) - 1.0)
    )


def expected_of_pairs(flown, there):
    """Equation (eq:safety_reward) of the worst pair, and how far the nearest is inside 8 NM."""
    position = np.asarray(flown.position_nm, dtype=np.float64)
    worst, nearest = 0.0, np.inf
    for one, other in combinations(there, 2):
        distance = np.linalg.norm(position[one] - position[other])
        closest = closest_nm(flown, one, other)
        worst = min(worst, (distance / 150.0 - 1.0) * np.exp(-((closest / 5.0) ** 2)))
        nearest = min(nearest, distance)
    return 3.0 * worst - 0.9 * max(8.0 - nearest, 0.0)


@pytest.mark.parametrize("there", [(0, 1, 2), (0, 1), (0, 2), (1,)])
def test_the_reward_of_a_cycle_is_the_weighted_sum_of_its_terms(cycle, flown, memory, there):
    """Averaged over all three aircraft; who has left pays nothing and is in nobody's way."""
    active = jnp.asarray([number in there for number in range(3)])
    each = [expected_of_aircraft(number, WAITED[number] + (number != 0)) for number in there]
    assert cycle.reward(memory, flown._replace(active=active)) == pytest.approx(
        sum(each) / 3.0 + expected_of_pairs(flown, there), abs=2e-4
    )


def test_bursts_and_instructions_of_the_cycle_are_priced(cycle, flown, memory):
    before = cycle.reward(memory, flown)
    told = changed(
        memory, new_bursts=jnp.float32(2.0), instructed=jnp.asarray([False, True, False])
    )
    # Aircraft 2 had waited four cycles with this one; now it has waited none.
    assert cycle.reward(told, flown) - before == pytest.approx(
        -0.6 * 2.0 - 0.25 * 0.4 / 3, abs=1e-5
    )


def test_straying_is_priced_when_it_happens(cycle, flown, memory):
    far = flown._replace(position_nm=flown.position_nm.at[1].set(jnp.asarray([300.0, 0.0])))
    inside = changed(memory, entered=jnp.asarray([True, True, True]))
    never = changed(memory, entered=jnp.asarray([True, False, True]))
    already = changed(inside, excursion=jnp.asarray([False, True, False]))
    now, later = cycle.reward(inside, far), cycle.reward(already, far)
    assert now - later == pytest.approx(-4.0 / 3.0, abs=1e-5)
    assert cycle.reward(never, far) == later


def test_scenarios_at_once_are_paid_each_by_itself(cycle, flown, memory):
    """Arrays with a batch axis behind their own: two end, one for both reasons; two go on."""
    alone = flown._replace(active=jnp.asarray([False, True, False]))
    gone = flown._replace(active=jnp.zeros(3, dtype=bool))
    late = changed(memory, cycles=jnp.float32(299.0), entered=jnp.asarray([True, False, True]))
    late = changed(late, instructions=jnp.asarray([1.0, 2.0, 30.0]), bursts=jnp.float32(5.0))
    cases = [(memory, flown), (late, flown), (memory, alone), (late, gone)]
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
    # The second has just entered; in the last nobody is left to.
    assert metrics["excursion"].tolist() == [False, False, False, True]
    assert np.isfinite(metrics["min_separation_nm"]).tolist() == [True, True, False, False]


def test_one_aircraft_is_in_nobodys_way(traffic_on):
    """No pair, no price: from the centreline, without an instruction, nothing is paid."""
    task = build_task(
        NavigationSettings(name="avoidance", aircraft=1, reward=RewardSettings(safety=3.0))
    )
    state = task.begin(traffic_on(STRAIGHT))
    assert cycles_of(task).reward(*state[::-1]) == pytest.approx(0.0, abs=1e-4)


FEW, MANY = (29.0, 0.0, 29.0), (0.0, 30.0, 0.0)


@pytest.mark.parametrize(
    ("right", "excursion", "instructions", "paid"),
    [
        ((True, True, True), (False, False, False), FEW, 35.0),
        ((True, True, False), (False, False, False), FEW, 5.0 + 10.0 / 3 + 5.0),
        ((True, True, True), (True, False, True), FEW, 5.0 + 5.0 / 3 + 5.0),
        ((True, True, True), (False, False, False), MANY, 5.0 + 5.0 + 10.0 / 3),
        ((False, False, False), (True, True, True), (30.0, 31.0, 30.0), 0.0),
    ],
    ids=["all", "an exit", "excursions", "instructions", "nothing"],
)
@pytest.mark.parametrize("cycles", [298.0, 299.0, 300.0])
def test_the_terminal_set_is_paid_at_the_end(
    cycle, flown, memory, cycles, right, excursion, instructions, paid
):
    state = changed(
        memory,
        entered=jnp.asarray([True, True, True]),
        exited_correctly=jnp.asarray(right),
        excursion=jnp.asarray(excursion),
        instructions=jnp.asarray(instructions),
    )
    on_the_way = cycle.reward(state, flown)
    _, outcome = cycle.end(changed(state, cycles=jnp.float32(cycles)), flown)
    assert bool(outcome.ended) == (cycles >= 299.0)
    assert not bool(outcome.truncated)
    assert float(outcome.reward[0]) - on_the_way == pytest.approx(
        2.0 * paid * (cycles >= 299.0), abs=1e-4
    )
    assert bool(outcome.metrics["success"]) == (paid == 35.0)
    assert bool(outcome.metrics["correct_exit"]) == all(right)
    assert bool(outcome.metrics["excursion"]) == any(excursion)
    assert bool(outcome.metrics["few_instructions"]) == (instructions == FEW)


def test_a_scenario_ends_when_nobody_is_left(cycle, flown, memory):
    """Nobody entered: only the count criterion holds."""
    gone = flown._replace(active=jnp.zeros(3, dtype=bool))
    outside = changed(memory, entered=jnp.asarray([False, False, False]))
    state, outcome = cycle.end(outside, gone)
    assert bool(outcome.ended)
    assert np.all(state.memory.progress.excursion)
    assert float(outcome.reward[0]) == pytest.approx(2.0 * 5.0)
    entered = changed(memory, entered=jnp.asarray([True, False, True]))
    np.testing.assert_array_equal(
        cycle.end(entered, gone)[0].memory.progress.excursion, [False, True, False]
    )
