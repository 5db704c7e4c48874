"""Training runs: their files, repetition, resumption, interruption, curriculum."""

import json
import shutil

import jax
import numpy as np
import pytest
from safetensors import safe_open

from skystack.errors import InputError, TrainingError
from skystack.files import alone_in
from skystack.learning import run
from skystack.learning.experiment import load_experiment
from skystack.learning.phases import learners
from skystack.learning.policy import load_policy
from skystack.learning.run import train_experiment

SMALL = (
    "ppo.total_steps=1024",
    "ppo.environments=8",
    "ppo.steps=32",
    "ppo.epochs=2",
    "ppo.minibatch=64",
)


def small(*changes, name="lateral"):
    return load_experiment(name, SMALL + changes)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    return folder, train_experiment(small(), 3, folder)


def weights(folder):
    return (folder / "policy.safetensors").read_bytes()


def test_a_run_leaves_its_files(trained):
    folder, ended = trained
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert [line["steps"] for line in lines] == [256, 512, 768, 1024]
    assert ended.steps == 1024
    assert load_policy(folder).description.seed == 3
    assert (folder / "config.toml").read_text().startswith('name = "lateral"')
    assert (folder / "checkpoint" / "learner.safetensors").exists()


def test_the_config_file_trains_the_same_policy_bit_for_bit(trained, tmp_path):
    again = load_experiment(str(trained[0] / "config.toml"))
    train_experiment(again, 3, tmp_path)
    assert weights(tmp_path) == weights(trained[0])


def test_another_seed_trains_another_policy(trained, tmp_path):
    train_experiment(small(), 4, tmp_path)
    assert weights(tmp_path) != weights(trained[0])


def test_an_interrupted_run_goes_on_to_the_same_policy(trained, tmp_path):
    def interrupt(progress):
        if progress.steps == 512:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_experiment(small(), 3, tmp_path, on_update=interrupt)
    assert not (tmp_path / "policy.json").exists()
    ended = train_experiment(small(), 3, tmp_path, resume=True)
    assert ended.steps == 1024
    assert weights(tmp_path) == weights(trained[0])
    lines = (tmp_path / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["update"] for line in lines] == [1, 2, 3, 4]


def test_a_checkpoint_of_another_configuration_is_refused(trained):
    with pytest.raises(InputError, match="another experiment, seed or configuration"):
        train_experiment(small("ppo.gamma=0.9"), 3, trained[0], resume=True)


def test_a_damaged_checkpoint_is_refused(trained, tmp_path):
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "learner.safetensors").write_bytes(b"not a checkpoint")
    with pytest.raises(InputError, match="not a checkpoint"):
        train_experiment(small(), 3, tmp_path, resume=True)


def test_a_loss_that_is_no_number_stops_training(tmp_path):
    changes = (
        "ppo.learning_rate=1e6",
        "ppo.reward_scale=1e6",
        "ppo.max_gradient_norm=1e6",
        "ppo.adam_epsilon=1e-30",
        "ppo.total_steps=20000",
    )
    said = "lateral, seed 0: value_loss is not finite after 256 steps; last good checkpoint: none"
    with pytest.raises(TrainingError, match=said):
        train_experiment(small(*changes), 0, tmp_path)
    assert not (tmp_path / "policy.json").exists()


def test_weights_that_are_no_numbers_are_not_saved(tmp_path, monkeypatch):
    def spoiled(updates, settings, learner):
        for number, updated, measured in learners(updates, settings, learner):
            broken = jax.tree.map(lambda leaf: leaf * np.nan, updated.parameters)
            yield number, updated._replace(parameters=broken) if number == 3 else updated, measured

    monkeypatch.setattr(run, "learners", spoiled)
    with pytest.raises(TrainingError, match="parameters are not finite after 768 steps"):
        train_experiment(small(), 3, tmp_path, checkpoint_every_s=0)
    assert json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])["update"] == 2
    with safe_open(tmp_path / "checkpoint" / "learner.safetensors", "numpy") as file:
        assert all(np.isfinite(file.get_tensor(f"{index:03d}")).all() for index in range(8))


def test_checkpoints_come_as_often_as_asked(tmp_path):
    checkpoint, seen = tmp_path / "checkpoint" / "learner.safetensors", []

    def note(progress):
        seen.append(checkpoint.read_bytes() if checkpoint.exists() else None)

    train_experiment(small(), 3, tmp_path / "rarely", on_update=note)
    assert seen == [None] * 4
    seen.clear()
    train_experiment(small(), 3, tmp_path, on_update=note, checkpoint_every_s=0)
    assert seen[0] is None
    assert len(set(seen)) == 4


def test_a_training_begun_anew_leaves_nothing_of_the_old_one(trained, tmp_path):
    """Killed before its first checkpoint, it must not be gone on with from another one's."""
    shutil.copytree(trained[0], tmp_path / "run")

    def interrupt(progress):
        assert not (tmp_path / "run" / "checkpoint" / "learner.safetensors").exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_experiment(small(), 4, tmp_path / "run", on_update=interrupt)


def test_a_folder_takes_one_training_at_a_time(tmp_path):
    with (
        alone_in(tmp_path),
        pytest.raises(InputError, match=f"^{tmp_path}: another skystack is at work"),
    ):
        train_experiment(small(), 3, tmp_path)
    assert not (tmp_path / "metrics.jsonl").exists()


def test_pretraining_changes_what_is_learned_first(trained, tmp_path):
    """The same rewards before and after are no pre-training at all; others are."""
    same = small("pretraining.steps=512")
    train_experiment(same, 3, tmp_path / "same")
    assert weights(tmp_path / "same") == weights(trained[0])
    other = small("pretraining.steps=512", "pretraining.reward.damping=5.0")
    train_experiment(other, 3, tmp_path / "other")
    assert weights(tmp_path / "other") != weights(trained[0])


def test_the_policy_on_disk_is_the_policy_trained(trained):
    folder, ended = trained
    seen = np.random.default_rng(0).uniform(size=(50, 8)).astype(np.float32)
    np.testing.assert_array_equal(load_policy(folder).logits(seen), ended.policy.logits(seen))
