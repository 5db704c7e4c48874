"""Registered tasks: a custom task is trained, evaluated, replayed and reported like ours."""

import runpy
from pathlib import Path

import msgspec
import numpy as np
import pytest

import skystack
from skystack.errors import InputError
from skystack.evaluation.stored import read_table
from skystack.learning.experiment import Experiment, experiment_from, resolved
from skystack.learning.settings import PPOSettings
from skystack.policies.shipped import find_policy
from skystack.reporting.replay.page import write_replay
from skystack.reporting.report import write_report
from skystack.reproduction.jobs import jobs_of, run_job
from skystack.reproduction.plan import Plan
from skystack.reproduction.run import run_plan
from skystack.tasks import registry
from skystack.tasks.conformance import check_task
from skystack.tasks.contract import TrafficTask
from skystack.tasks.kinds import Family, TaskKind
from skystack.tasks.registry import (
    build_task,
    find_task,
    register_task,
    tasks,
    unregister_task,
)
from skystack.tasks.settings import NavigationSettings

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_task.py"
SMALL = PPOSettings(total_steps=256, environments=8, steps=32, minibatch=128, hidden=(8,))


@pytest.fixture(scope="module")
def holding():
    """The module of the example, which registers its task when it is imported."""
    module = runpy.run_path(str(EXAMPLE), run_name="own_task")
    yield module
    unregister_task("holding")


@pytest.fixture
def experiment(holding):
    settings = holding["HoldingSettings"](name="holding", cycles=20)
    return Experiment(name="mine", task=settings, ppo=SMALL)


def test_example_task_satisfies_the_contract(holding):
    task = build_task(holding["HoldingSettings"](name="holding"))
    assert isinstance(task, TrafficTask)
    check_task(task)


def test_checks_the_settings_of_a_custom_task(holding, experiment):
    values = resolved(experiment)
    assert experiment_from(values, "mine") == experiment
    values["task"]["radius"] = 3.0
    wrong = r"^mine: unknown key 'task.radius'; did you mean 'task.radius_nm'\?"
    with pytest.raises(InputError, match=wrong):
        experiment_from(values, "mine")
    values["task"] = {"name": "holding", "radius_nm": "far"}
    with pytest.raises(InputError, match=r'^mine: task.radius_nm is "far" \(allowed: number\)'):
        experiment_from(values, "mine")
    values["task"] = {"name": "holding", "reward": {}}
    with pytest.raises(InputError, match=r"^mine: unknown key 'task.reward'"):
        experiment_from(values, "mine")
    values["task"], values["pretraining"] = {"name": "holding"}, {"steps": 5}
    with pytest.raises(InputError, match=r"task holding has no table reward"):
        experiment_from(values, "mine")


@pytest.mark.slow
def test_trains_evaluates_replays_and_reports_a_custom_task(experiment, tmp_path):
    """A complete reproduction of one experiment, in this process."""
    run = tmp_path / "run"
    plan = Plan((experiment,), 1, 4, run, False, "own task")
    result = run_plan(
        plan, print, lambda plan, _: [run_job(job, lambda message: None) for job in jobs_of(plan)]
    )
    assert [(row["experiment"], row["task"]) for row in result["rows"]] == [
        *(("mine", "holding"), ("mine", "holding"), ("do-nothing-holding", "holding"))
    ]
    report = write_report(run).read_text()
    assert "Holding" in report
    assert "mine, stacked" in report
    assert "Lateral navigation" not in report
    evaluation = run / "evaluation" / "mine-s0-skystack-stacked"
    episodes = read_table(evaluation / "episodes.parquet", ("cycles", "success"))
    assert episodes["cycles"].to_pylist() == [20] * 4
    page = write_replay([evaluation], tmp_path / "replay.html")
    assert page["scenarios"] == 4
    policy = find_policy(run / "train" / "mine-s0")
    assert policy.description.task_name == "holding"
    again = skystack.evaluate(policy, skystack.Conditions(episodes=4)).row
    assert again["clearances_mean"] == result["rows"][1]["clearances_mean"]


def test_refuses_unknown_and_duplicate_names(holding):
    with pytest.raises(InputError, match=r"^unknown task 'lateral-'; did you mean 'lateral'\?"):
        find_task("lateral-")
    other = TaskKind(Family("lateral", "Mine"), NavigationSettings, print, "another")
    with pytest.raises(InputError, match=r"^task lateral is already registered"):
        register_task(other)
    register_task(tasks()["lateral"])  # registering the same kind again is allowed
    with pytest.raises(InputError, match=r"task.name: unknown task 'holdin'"):
        experiment_from({"name": "mine", "task": {"name": "holdin"}}, "mine")


def test_finds_tasks_of_installed_packages(monkeypatch):
    kind = TaskKind(Family("elsewhere", "Elsewhere"), NavigationSettings, print, "another")

    class Found:
        def load(self):
            return kind

    monkeypatch.setattr(registry, "entry_points", lambda group: [Found()])
    registry._load_entry_points.cache_clear()
    try:
        assert find_task("elsewhere") == kind
        assert tasks()["elsewhere"].description == "another"
    finally:
        unregister_task("elsewhere")
        registry._load_entry_points.cache_clear()


@pytest.mark.usefixtures("types_unchecked")
def test_refuses_to_evaluate_a_task_without_traffic(monkeypatch):
    kind = TaskKind(Family("bare", "Bare"), NavigationSettings, lambda settings: Bare(), "none")
    register_task(kind)
    settings = msgspec.structs.replace(NavigationSettings(), name="bare")
    with pytest.raises(
        InputError, match=r"^task bare has no traffic \(allowed: tasks that implement"
    ):
        skystack.evaluate(np.argmax, experiment=Experiment("bare", task=settings))
    unregister_task("bare")


class Bare:
    name = "bare"
