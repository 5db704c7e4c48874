"""Trainings and evaluations of a reproduction: gone on with, and not repeated."""

import json

import numpy as np
import pytest

from skystack.errors import InputError
from skystack.learning.experiment import load_experiment
from skystack.learning.run import train_experiment
from skystack.reproduction import jobs
from skystack.reproduction.jobs import flown_once, no_op_once, trained_once
from skystack.reproduction.plan import Plan

SMALL = ("ppo.total_steps=1024", "ppo.environments=8", "ppo.steps=32", "ppo.minibatch=64")


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("lateral", SMALL)


@pytest.fixture
def plan(experiment, tmp_path):
    return Plan((experiment,), 1, 3, tmp_path, False, "command")


def nothing(progress):
    pass


def fail(progress):
    raise AssertionError("trained again")


def test_an_interrupted_training_is_gone_on_with_and_then_kept(plan, experiment, tmp_path):
    whole = train_experiment(experiment, 1, tmp_path / "whole")
    heard = []

    def interrupt(progress):
        heard.append(progress.steps)
        if len(heard) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trained_once(plan, experiment, 1, interrupt)
    policy, summary, kept = trained_once(
        plan, experiment, 1, lambda progress: heard.append(progress.steps)
    )
    assert heard[:2] == [256, 512]
    assert heard[-1] == 1024
    assert len(heard) <= 5
    assert not kept
    assert summary["steps"] == 1024
    for (ours, _), (theirs, _) in zip(policy.actor, whole.policy.actor, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    again, same, kept = trained_once(plan, experiment, 1, fail)
    assert kept
    assert same == summary
    assert again.description.sha256 == policy.description.sha256


def test_another_configuration_in_the_same_folder_is_trained_anew(plan, experiment):
    first, _, _ = trained_once(plan, experiment, 1, nothing)
    other = load_experiment("lateral", (*SMALL, "task.reward.damping=1.0"))
    second, _, kept = trained_once(plan, other, 1, nothing)
    assert not kept
    assert second.description.sha256 != first.description.sha256


def test_a_checkpoint_that_is_no_use_is_trained_over(plan, experiment):
    trained_once(plan, experiment, 1, nothing)
    folder = plan.training("lateral-s1")
    (folder / "training.json").unlink()
    (folder / "checkpoint" / "learner.safetensors").write_bytes(b"no checkpoint")
    _, summary, kept = trained_once(plan, experiment, 1, nothing)
    assert not kept
    assert summary["steps"] == 1024


def test_a_full_disk_does_not_begin_a_training_anew(plan, experiment, monkeypatch):
    """Only what cannot be gone on with is thrown away."""
    trained_once(plan, experiment, 1, nothing)
    folder = plan.training("lateral-s1")
    (folder / "training.json").unlink()
    resumed = []

    def full(experiment, seed, folder, resume, on_update, every_s):
        resumed.append(resume)
        raise InputError("cannot be written: No space left on device")

    monkeypatch.setattr(jobs, "train_experiment", full)
    with pytest.raises(InputError, match="No space left"):
        trained_once(plan, experiment, 1, nothing)
    assert resumed == [True]


def test_evaluations_are_kept_until_policy_scenarios_or_tables_change(plan, experiment):
    policy, _, _ = trained_once(plan, experiment, 1, nothing)
    first, kept = flown_once(plan, policy, stacking=True)
    assert not kept
    second, kept = flown_once(plan, policy, stacking=True)
    assert kept
    assert second.row == first.row
    assert second.episodes == first.episodes
    table = plan.evaluation / "lateral-s1-skystack-stacked" / "trajectories.parquet"
    table.write_bytes(table.read_bytes()[:-1])
    assert not flown_once(plan, policy, stacking=True)[1]
    more = Plan(**vars(plan) | {"episodes": 4})
    found, kept = flown_once(more, policy, stacking=True)
    assert not kept
    assert found.row["episodes"] == found.episodes.num_rows == 4


def test_nobody_is_flown_once(plan, experiment):
    first, kept = no_op_once(plan, experiment)
    assert not kept
    assert first.row["clearances_mean"] == 0.0
    assert no_op_once(plan, experiment)[1]
    record = plan.evaluation / "do-nothing-s0-skystack-plain" / "row.json"
    assert json.loads(record.read_text())["result"] == first.row
