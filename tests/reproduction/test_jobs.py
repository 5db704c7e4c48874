"""Trainings and evaluations of a reproduction are resumed, and cached when finished."""

import json

import numpy as np
import pytest

from skystack.errors import InputError
from skystack.learning.experiment import load_experiment
from skystack.learning.run import train_experiment
from skystack.reproduction import jobs
from skystack.reproduction.jobs import (
    Job,
    Way,
    evaluate_no_op_or_load,
    evaluate_or_load,
    jobs_of,
    longest_first,
    run_job,
    train_or_load,
)
from skystack.reproduction.plan import Plan, make_plan

SMALL = ("ppo.total_steps=1024", "ppo.environments=8", "ppo.steps=32", "ppo.minibatch=64")
STACKED = Way(stacking=True, greedy=True)


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("lateral", SMALL)


@pytest.fixture
def plan(experiment, tmp_path):
    return Plan((experiment,), 1, 3, tmp_path, False, "command")


def ignore(progress):
    pass


def fail(progress):
    raise AssertionError("trained again")


@pytest.mark.slow
def test_resumes_an_interrupted_training_then_caches_it(plan, experiment, tmp_path):
    uninterrupted = train_experiment(experiment, 1, tmp_path / "uninterrupted")
    reported = []

    def interrupt(progress):
        reported.append(progress.steps)
        if len(reported) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_or_load(plan, experiment, 1, interrupt)
    policy, summary, cached = train_or_load(
        plan, experiment, 1, lambda progress: reported.append(progress.steps)
    )
    assert reported[:2] == [256, 512]
    assert reported[-1] == 1024
    assert len(reported) <= 5
    assert not cached
    assert summary["steps"] == 1024
    for (ours, _), (theirs, _) in zip(policy.actor, uninterrupted.policy.actor, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    again, same, cached = train_or_load(plan, experiment, 1, fail)
    assert cached
    assert same == summary
    assert again.description.sha256 == policy.description.sha256


@pytest.mark.slow
def test_retrains_for_another_configuration(plan, experiment):
    first, _, _ = train_or_load(plan, experiment, 1, ignore)
    other = load_experiment("lateral", (*SMALL, "task.reward.damping=1.0"))
    second, _, cached = train_or_load(plan, other, 1, ignore)
    assert not cached
    assert second.description.sha256 != first.description.sha256


@pytest.mark.slow
def test_retrains_over_a_damaged_checkpoint(plan, experiment):
    train_or_load(plan, experiment, 1, ignore)
    folder = plan.training("lateral-s1")
    (folder / "training.json").unlink()
    (folder / "checkpoint" / "learner.safetensors").write_bytes(b"no checkpoint")
    _, summary, cached = train_or_load(plan, experiment, 1, ignore)
    assert not cached
    assert summary["steps"] == 1024


@pytest.mark.slow
def test_full_disk_does_not_restart_a_training(plan, experiment, monkeypatch):
    """Only a checkpoint that cannot be resumed is discarded."""
    train_or_load(plan, experiment, 1, ignore)
    folder = plan.training("lateral-s1")
    (folder / "training.json").unlink()
    resumed = []

    def full(experiment, seed, folder, resume, on_update, every_s):
        resumed.append(resume)
        raise InputError("cannot be written: No space left on device")

    monkeypatch.setattr(jobs, "train_experiment", full)
    with pytest.raises(InputError, match="No space left"):
        train_or_load(plan, experiment, 1, ignore)
    assert resumed == [True]


@pytest.mark.slow
def test_evaluations_are_cached_until_tables_or_episodes_change(plan, experiment):
    policy, _, _ = train_or_load(plan, experiment, 1, ignore)
    first, cached = evaluate_or_load(plan, policy, STACKED)
    assert not cached
    second, cached = evaluate_or_load(plan, policy, STACKED)
    assert cached
    assert second.row == first.row
    assert second.episodes == first.episodes
    table = plan.evaluation / "lateral-s1-skystack-stacked" / "trajectories.parquet"
    table.write_bytes(table.read_bytes()[:-1])
    assert not evaluate_or_load(plan, policy, STACKED)[1]
    more = Plan(**vars(plan) | {"episodes": 4})
    found, cached = evaluate_or_load(more, policy, STACKED)
    assert not cached
    assert found.row["episodes"] == found.episodes.num_rows == 4


@pytest.mark.slow
def test_sampled_actions_are_evaluated_beside_the_most_probable_ones(plan, experiment):
    both = Plan(**vars(plan) | {"with_sampled": True})
    job = Job(both, experiment, 1)
    flown = run_job(job, lambda message: None).flown
    assert [Way(each.row["stacking"], each.row["greedy"]) for each in flown] == [
        Way(False, True),
        Way(True, True),
        Way(False, False),
        Way(True, False),
    ]
    assert sorted(each.name for each in job.folders if each.parent == both.evaluation) == [
        "lateral-s1-skystack-plain",
        "lateral-s1-skystack-plain-sampled",
        "lateral-s1-skystack-stacked",
        "lateral-s1-skystack-stacked-sampled",
    ]
    assert all(each.exists() for each in job.folders)
    # An untrained network is nearly uniform, so most sampled actions are instructions.
    assert flown[2].row["instructions_mean"] > 50.0
    cached = run_job(job, lambda message: None)
    assert len(cached.kept) == 5
    assert [each.row for each in cached.flown] == [each.row for each in flown]


def test_jobs_of_a_first_look_include_shipped_policies_and_doing_nothing(tmp_path):
    plan = make_plan([], 2, 3, tmp_path, False, "command")
    jobs = jobs_of(plan)
    assert [job.name for job in jobs] == [
        *("lateral-s0", "lateral-best-s0", "lateral-s1", "lateral-best-s1"),
        *("lateral-shipped", "lateral-best-shipped", "do-nothing-lateral"),
    ]
    assert [each.ppo.total_steps for each in plan.experiments] == [2_000_000, 12_000_000]
    assert [job.kind for job in longest_first(jobs)[:4]] == ["train"] * 4
    assert longest_first(jobs)[0].experiment.name == "lateral-best"


@pytest.mark.slow
def test_shipped_policy_is_evaluated_stacked_under_its_own_name(plan, experiment):
    job = Job(plan, experiment, 0, "shipped")
    messages = []
    result = run_job(job, messages.append)
    (flown,) = result.flown
    assert (result.train, result.kept) == (None, ())
    assert (flown.row["experiment"], flown.row["stacking"]) == ("lateral-shipped", True)
    assert flown.row["success_rate"] == 1.0
    assert [folder.name for folder in job.folders] == [
        path.name for path in plan.evaluation.iterdir()
    ]
    assert messages == [("lateral-shipped", "evaluating"), ("lateral-shipped", "done")]
    assert run_job(job, messages.append).kept == ("evaluation lateral-shipped",)


def test_no_op_evaluation_is_cached(plan, experiment):
    first, cached = evaluate_no_op_or_load(plan, experiment)
    assert not cached
    assert first.row["clearances_mean"] == 0.0
    assert evaluate_no_op_or_load(plan, experiment)[1]
    record = plan.evaluation / "do-nothing-lateral-s0-skystack-plain" / "row.json"
    assert json.loads(record.read_text())["result"] == first.row
