"""Flights of the study against the evaluation of the package, and the check of clearances."""

import pytest

from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.learning.experiment import experiment_from
from skystack.policies.shipped import find_policy
from studies.neighbours import learner
from studies.neighbours.flights import fly
from studies.neighbours.methods import METHODS, Way, build

SCENARIOS = 40


@pytest.mark.parametrize("stacked", [True, False])
@pytest.mark.parametrize("name", ["lateral-best", "avoidance-best"])
def test_agrees_with_the_evaluation_of_the_package(name, stacked):
    policy = find_policy(name)
    row = evaluate(policy, Conditions(episodes=SCENARIOS, stacking=stacked)).row
    experiment = experiment_from(policy.description.config, name)
    tasks = build(METHODS["frozen time"], experiment)
    decide = learner.network_policy(None, greedy=True)
    found = fly(tasks, decide, (policy.actor, policy.normaliser), Way(stacked), SCENARIOS)
    assert found["clearances_mean"] == pytest.approx(row["clearances_mean"], abs=1e-4)
    assert found["clearances_std"] == pytest.approx(row["clearances_std"], abs=1e-4)
    assert found["losses"] == row["loss_of_separation_count"]
    assert found["success_rate"] >= row["success_rate"]  # here any number of clearances succeeds
