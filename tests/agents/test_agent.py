"""Objects that are policies, their names and their experiments."""

import pickle

import numpy as np
import pytest

import skystack
from skystack.agents.agent import Agent, Batched, agent_of
from skystack.errors import InputError
from skystack.evaluation.evaluate import Conditions, agent_task

FEW = Conditions(episodes=2)


class Model:
    """The interface of a model of Stable-Baselines3. Its generator cannot be pickled."""

    def __init__(self, state=None):
        self._state, self.generator = state, (item for item in ())

    def predict(self, observation, deterministic=False):
        assert deterministic
        return np.zeros(len(observation), dtype=np.int64), self._state


@pytest.mark.slow
def test_names_are_derived_from_the_policy():
    def rule(observation):
        return 0

    assert agent_of(rule).name == agent_of(Batched(rule)).name == "rule"
    assert agent_of(Model()).name == "Model"
    assert agent_of(lambda observation: 0).name == "policy"
    result = skystack.evaluate(rule, FEW, experiment="lateral", name="no rule")
    assert result.row["experiment"] == "no-rule"


def test_rejects_an_object_that_is_not_a_policy():
    with pytest.raises(InputError, match=r"^policy is 3 .allowed: .*find_agent"):
        skystack.evaluate(3, FEW, experiment="lateral")


def test_requires_an_experiment_that_fits():
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


def test_rejects_an_experiment_for_our_own_policies():
    with pytest.raises(InputError, match=r"^lateral already names its experiment"):
        skystack.evaluate(skystack.find_policy("lateral"), FEW, experiment="lateral")


def test_rejects_sampling_from_a_function():
    sampling = FEW._replace(greedy=False)
    with pytest.raises(InputError, match="no probabilities to sample from"):
        skystack.evaluate(lambda observation: 0, sampling, experiment="lateral")


@pytest.mark.slow
def test_accepts_a_model_that_predicts_but_no_recurrent_one():
    result = skystack.evaluate(Model(), FEW, experiment="lateral")
    assert result.row["clearances_mean"] == 0.0
    with pytest.raises(InputError, match=r"^scenario 0 and 1 more, cycle 0: it is recurrent"):
        skystack.evaluate(Model(state=(1, 2)), FEW, experiment="lateral")


def test_functions_can_be_pickled():
    """Including closures and lambdas, which plain pickle refuses."""
    offset = 3
    agent = pickle.loads(pickle.dumps(agent_of(lambda observation: len(observation) - offset)))
    assert agent.act(np.zeros(5)) == 2


def test_rejects_a_model_that_cannot_be_pickled():
    pytest.importorskip("bluebird_dt")
    elsewhere = FEW._replace(platform="bluebird")
    with pytest.raises(InputError, match="cannot be sent to other processes"):
        skystack.evaluate(Model(), elsewhere, experiment="lateral")
