"""What is a policy, what it is called, and for which experiment it is."""

import pickle

import numpy as np
import pytest

import skystack
from skystack.agents.agent import Agent, Batched, agent_of
from skystack.errors import InputError
from skystack.evaluation.evaluate import Conditions, agent_task

FEW = Conditions(episodes=2)


class Model:
    """What Stable-Baselines3's models look like from outside."""

    def __init__(self, state=None):
        self._state, self.lock = state, (open_end for open_end in ())

    def predict(self, observation, deterministic=False):
        assert deterministic
        return np.zeros(len(observation), dtype=np.int64), self._state


def test_names_come_from_what_is_given():
    def rule(observation):
        return 0

    assert agent_of(rule).name == agent_of(Batched(rule)).name == "rule"
    assert agent_of(Model()).name == "Model"
    assert agent_of(lambda observation: 0).name == "policy"
    judged = skystack.evaluate(rule, FEW, experiment="lateral", name="no rule")
    assert judged.row["experiment"] == "no-rule"


def test_what_is_no_policy_is_refused():
    with pytest.raises(InputError, match=r"^policy is 3 .allowed: .*find_agent"):
        skystack.evaluate(3, FEW, experiment="lateral")


def test_the_experiment_must_be_given_and_fit():
    with pytest.raises(InputError, match=r"needs an experiment.*--experiment NAME or FILE.toml"):
        skystack.evaluate(lambda observation: 0, FEW)
    with pytest.raises(InputError, match="did you mean 'lateral'"):
        skystack.evaluate(lambda observation: 0, FEW, experiment="laterla")
    wrong = Agent("wrong", act=len, observations=7, actions=5)
    message = r"^wrong has 7 observed values and 5 actions \(allowed for vertical: 4, 3\)$"
    with pytest.raises(InputError, match=message):
        agent_task(wrong, "vertical")
    some = Agent("some", act=len, actions=3)
    assert agent_task(some, "vertical", "merge").sector.name == "merge"


def test_our_own_policies_carry_their_experiment():
    with pytest.raises(InputError, match=r"^lateral carries its own experiment"):
        skystack.evaluate(skystack.find_policy("lateral"), FEW, experiment="lateral")


def test_a_function_has_no_probabilities():
    greedless = FEW._replace(greedy=False)
    with pytest.raises(InputError, match="no probabilities to sample from"):
        skystack.evaluate(lambda observation: 0, greedless, experiment="lateral")


def test_a_model_that_predicts_is_a_policy():
    judged = skystack.evaluate(Model(), FEW, experiment="lateral")
    assert judged.row["clearances_mean"] == 0.0
    with pytest.raises(InputError, match=r"^scenario 0 and 1 more, cycle 0: it is recurrent"):
        skystack.evaluate(Model(state=(1, 2)), FEW, experiment="lateral")


def test_functions_reach_other_processes():
    """Closures and lambdas, which plain pickle refuses."""
    offset = 3
    agent = pickle.loads(pickle.dumps(agent_of(lambda observation: len(observation) - offset)))
    assert agent.act(np.zeros(5)) == 2


def test_what_cannot_reach_other_processes_is_refused():
    pytest.importorskip("bluebird_dt")
    elsewhere = FEW._replace(platform="bluebird")
    with pytest.raises(InputError, match="cannot be sent to other processes"):
        skystack.evaluate(Model(), elsewhere, experiment="lateral")
