"""Flights of the study against the evaluation of the package, and the check of clearances."""

import jax
import jax.numpy as jnp
import pytest

from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.learning.experiment import experiment_from
from skystack.policies.shipped import find_policy
from skystack.simulator.traffic import start, ticks
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from studies.neighbours import learner
from studies.neighbours.flights import fly, worse
from studies.neighbours.methods import METHODS, Way, build

SCENARIOS = 40


@pytest.mark.slow
@pytest.mark.parametrize("stacked", [True, False])
@pytest.mark.parametrize("name", ["lateral-best", "avoidance-best"])
def test_agrees_with_the_evaluation_of_the_package(name, stacked):
    policy = find_policy(name)
    row = evaluate(policy, Conditions(episodes=SCENARIOS, stacking=stacked)).row
    experiment = experiment_from(policy.description.config, name)
    tasks = build(METHODS["frozen time"], experiment)
    decide = learner.network_policy(tasks, greedy=True)
    found = fly(tasks, decide, (policy.actor, policy.normaliser), Way(stacked), SCENARIOS)
    assert found["clearances_mean"] == pytest.approx(row["clearances_mean"], abs=1e-4)
    assert found["clearances_std"] == pytest.approx(row["clearances_std"], abs=1e-4)
    assert found["losses"] == row["loss_of_separation_count"]
    assert found["success_rate"] >= row["success_rate"]  # here any number of clearances succeeds


def test_the_best_decision_is_the_best_action_and_then_its_best_length():
    """The no-op has probability 0.6, spread equally over three lengths. The other action has 0.4,
    of which 0.35 is for one length."""
    probabilities = jnp.array([0.2, 0.2, 0.2, 0.05, 0.35, 0.0])
    decision = learner.best_action_and_length(jnp.log(probabilities), 3)
    assert int(jnp.argmax(probabilities)) == 4
    assert int(decision) == 0


@pytest.fixture(scope="module")
def head_on():
    """Two aircraft 34 NM apart on reciprocal tracks 7.8 NM apart."""
    task = build_task(NavigationSettings())
    sector = task.sector
    route = sector.routes.index(("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT"))
    back = sector.routes.index(("SWIFT", "QUAIL", "MACAW", "EGL", "CRANE", "HERON"))
    level = jnp.full(2, ticks(300.0), dtype=jnp.float32)
    traffic = start(
        position_nm=jnp.array([[-10.0, -10.0], [8.0, 19.0]]),
        heading_deg=jnp.array([45.0, 225.0]),
        level_ticks=level,
        route=jnp.array([route, back], dtype=jnp.int32),
        ground_speed_kt=task.simulator.level_ground_speed_kt(level),
        own_navigation=jnp.zeros(2, dtype=bool),
    )
    state = task.begin(traffic)
    return task, jax.jit(task.step)(state, jnp.asarray(0))[0]


def turned(task, state, *actions):
    for each in actions:
        state = task.instruct(state, jnp.asarray(each))
    return state


@pytest.mark.slow
def test_a_clearance_is_worse_if_it_adds_a_loss_or_an_excursion(head_on):
    """Straight on, they pass 7.8 NM apart and stay inside. Left by 20 degrees, the first aircraft
    comes within 2.7 NM of the second and leaves the sector; right by 20 degrees, it only leaves."""
    task, straight = head_on
    check = jax.jit(lambda before, after: worse(task, task.sector.loss_below_nm, before, after))
    left, right = turned(task, straight, 1, 1), turned(task, straight, 2, 2)
    assert bool(check(straight, left))
    assert bool(check(straight, right))
    assert bool(check(right, left))  # an excursion in both, a loss in one
    for before, after in ((left, right), (left, straight), (right, straight), (left, left)):
        assert not bool(check(before, after))
