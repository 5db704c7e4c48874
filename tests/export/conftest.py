"""Evaluations that the tests export."""

from functools import cache

import pytest

from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.summary import evaluation_folder
from skystack.policies.shipped import find_policy

EPISODES = 3


@pytest.fixture(scope="session")
def out(tmp_path_factory):
    """The folder of all evaluations."""
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture(scope="session")
def folder(out):
    """The folder of the stacked evaluation of `lateral-best`."""
    return evaluation_of(out, "lateral-best")


@cache
def evaluation_of(out, policy):
    """The folder of the stacked evaluation of a policy, which is flown once."""
    evaluate(find_policy(policy), Conditions(episodes=EPISODES), out)
    return evaluation_folder(out, policy, 0, stacking=True)
