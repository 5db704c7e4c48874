"""Evaluations to export from."""

from functools import cache

import pytest

from skystack.evaluation.evaluate import Conditions, evaluate, evaluation_folder
from skystack.policies.shipped import find_policy

EPISODES = 3


@pytest.fixture(scope="session")
def out(tmp_path_factory):
    """Where evaluations lie."""
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture(scope="session")
def folder(out):
    """The evaluation of `lateral-best`, stacked."""
    return evaluated(out, "lateral-best")


@cache
def evaluated(out, policy):
    """The folder of a stacked evaluation."""
    evaluate(find_policy(policy), Conditions(episodes=EPISODES), out)
    return evaluation_folder(out, policy, 0, stacking=True)
