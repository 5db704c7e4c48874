"""Training runs: files, reproducibility, interruption, resumption and pre-training."""

import contextlib
import json
import shutil

import jax
import numpy as np
import pytest
from safetensors import safe_open

from skystack.errors import InputError, TrainingError
from skystack.io.locks import locked_folder
from skystack.learning import run
from skystack.learning.experiment import load_experiment
from skystack.learning.phases import run_updates
from skystack.learning.policy import load_policy
from skystack.learning.run import preflight, train_experiment
from skystack.tasks.navigation import NavigationTask

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


def weight_bytes(folder):
    return (folder / "policy.safetensors").read_bytes()


@pytest.mark.slow
def test_run_writes_its_files(trained):
    folder, result = trained
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert [line["steps"] for line in lines] == [256, 512, 768, 1024]
    assert result.steps == 1024
    assert load_policy(folder).description.seed == 3
    assert (folder / "config.toml").read_text().startswith('name = "lateral"')
    assert (folder / "checkpoint" / "learner.safetensors").exists()


@pytest.mark.slow
def test_config_file_trains_a_bit_identical_policy(trained, tmp_path):
    again = load_experiment(str(trained[0] / "config.toml"))
    train_experiment(again, 3, tmp_path)
    assert weight_bytes(tmp_path) == weight_bytes(trained[0])


@pytest.mark.slow
def test_other_seeds_train_other_policies(trained, tmp_path):
    train_experiment(small(), 4, tmp_path)
    assert weight_bytes(tmp_path) != weight_bytes(trained[0])


@pytest.mark.slow
def test_resumed_run_trains_the_same_policy(trained, tmp_path):
    def interrupt(progress):
        if progress.steps == 512:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_experiment(small(), 3, tmp_path, on_update=interrupt)
    assert not (tmp_path / "policy.json").exists()
    result = train_experiment(small(), 3, tmp_path, resume=True)
    assert result.steps == 1024
    assert weight_bytes(tmp_path) == weight_bytes(trained[0])
    lines = (tmp_path / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line)["update"] for line in lines] == [1, 2, 3, 4]


def test_rejects_a_checkpoint_of_another_configuration(trained):
    with pytest.raises(InputError, match="another experiment, seed or configuration"):
        train_experiment(small("ppo.gamma=0.9"), 3, trained[0], resume=True)


def test_rejects_a_damaged_checkpoint(trained, tmp_path):
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "learner.safetensors").write_bytes(b"not a checkpoint")
    with pytest.raises(InputError, match="not a checkpoint"):
        train_experiment(small(), 3, tmp_path, resume=True)


@pytest.mark.slow
def test_non_finite_loss_stops_training(tmp_path):
    changes = (
        "ppo.learning_rate=1e6",
        "ppo.reward_scale=1e6",
        "ppo.max_gradient_norm=1e6",
        "ppo.adam_epsilon=1e-30",
        "ppo.total_steps=20000",
    )
    message = (
        "lateral, seed 0: value_loss is not finite after 256 steps; last good checkpoint: none"
    )
    with pytest.raises(TrainingError, match=message):
        train_experiment(small(*changes), 0, tmp_path)
    assert not (tmp_path / "policy.json").exists()


@pytest.mark.slow
def test_non_finite_weights_are_not_saved(tmp_path, monkeypatch):
    def damaged_updates(updates, settings, learner):
        for number, updated, measured in run_updates(updates, settings, learner):
            damaged = jax.tree.map(lambda leaf: leaf * np.nan, updated.parameters)
            yield number, updated._replace(parameters=damaged) if number == 3 else updated, measured

    monkeypatch.setattr(run, "run_updates", damaged_updates)
    with pytest.raises(TrainingError, match="non-finite value in the parameters after 768 steps"):
        train_experiment(small(), 3, tmp_path, checkpoint_every_s=0)
    assert json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])["update"] == 2
    with safe_open(tmp_path / "checkpoint" / "learner.safetensors", "numpy") as file:
        assert all(np.isfinite(file.get_tensor(f"{index:03d}")).all() for index in range(8))


@pytest.mark.slow
def test_saves_checkpoints_as_often_as_requested(tmp_path):
    checkpoint, seen = tmp_path / "checkpoint" / "learner.safetensors", []

    def note(progress):
        seen.append(checkpoint.read_bytes() if checkpoint.exists() else None)

    train_experiment(small(), 3, tmp_path / "rarely", on_update=note)
    assert seen == [None] * 4
    seen.clear()
    train_experiment(small(), 3, tmp_path, on_update=note, checkpoint_every_s=0)
    assert seen[0] is None
    assert len(set(seen)) == 4


@pytest.mark.slow
def test_new_training_removes_the_old_checkpoint(trained, tmp_path):
    """If it is killed before its first checkpoint, the old one must not be resumed."""
    shutil.copytree(trained[0], tmp_path / "run")

    def interrupt(progress):
        assert not (tmp_path / "run" / "checkpoint" / "learner.safetensors").exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_experiment(small(), 4, tmp_path / "run", on_update=interrupt)


def test_folder_allows_one_training_at_a_time(tmp_path):
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "learner.safetensors").touch()
    for attempt in (
        lambda: train_experiment(small(), 3, tmp_path),
        lambda: preflight(small(), tmp_path, resume=False),  # despite an unfinished training in it
    ):
        with (
            locked_folder(tmp_path),
            pytest.raises(InputError, match=f"^{tmp_path}: is in use by another process"),
        ):
            attempt()
    assert not (tmp_path / "metrics.jsonl").exists()


def test_rejects_a_seed_out_of_range(tmp_path):
    for seed in (-1, 2**31):
        with pytest.raises(
            InputError, match=r"^seed is .* \(allowed: whole numbers from 0 to 2147"
        ):
            train_experiment(small(), seed, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_pretraining_rewards_change_the_policy(trained, tmp_path):
    """Pre-training with the same rewards changes nothing; with other rewards it does."""
    same = small("pretraining.steps=512")
    train_experiment(same, 3, tmp_path / "same")
    assert weight_bytes(tmp_path / "same") == weight_bytes(trained[0])
    other = small("pretraining.steps=512", "pretraining.reward.damping=5.0")
    train_experiment(other, 3, tmp_path / "other")
    assert weight_bytes(tmp_path / "other") != weight_bytes(trained[0])


def test_saved_policy_is_the_trained_policy(trained):
    folder, result = trained
    seen = np.random.default_rng(0).uniform(size=(50, 8)).astype(np.float32)
    np.testing.assert_array_equal(load_policy(folder).logits(seen), result.policy.logits(seen))


class Clock:
    """A clock that moves only when `now` is changed."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now


@pytest.fixture
def counting_updates(monkeypatch):
    """Replace training by counting updates. They take ten seconds and measure constants."""
    clock = Clock()
    measured = {"return": np.nan, "policy_loss": 0.1, "value_loss": 0.2, "entropy": 1.5}

    def count(updates, settings, learner):
        for number in range(int(learner.updates) + 1, settings.updates + 1):
            clock.now += 10.0
            learner = learner._replace(updates=jax.numpy.asarray(number, dtype="int32"))
            yield number, learner, measured

    monkeypatch.setattr(run, "run_updates", count)
    monkeypatch.setattr(run, "compiled_updates", lambda *_: contextlib.nullcontext({}))
    monkeypatch.setattr(run.time, "monotonic", clock.monotonic)
    return clock


TINY = small("ppo.hidden=[2]")


def test_rejects_a_task_with_several_agents(tmp_path, monkeypatch):
    """PPO supports one agent; nothing is written."""
    monkeypatch.setattr(NavigationTask, "agents", 2)
    experiment = load_experiment("lateral")
    for attempt in (
        lambda: train_experiment(experiment, 0, tmp_path / "run"),
        lambda: preflight(experiment, tmp_path / "run", False),
    ):
        with pytest.raises(InputError, match=r"^task lateral has 2 agents \(allowed"):
            attempt()
    assert list(tmp_path.iterdir()) == []


def test_reports_progress_after_every_update(counting_updates, tmp_path):
    """256 steps in ten seconds. The first update is not timed: it includes compilation."""
    reports = []
    result = train_experiment(TINY, 3, tmp_path, on_update=reports.append)
    assert [progress.steps for progress in reports] == [256, 512, 768, 1024]
    assert {progress.total_steps for progress in reports} == {1024}
    assert np.isnan(reports[0].steps_per_s)
    assert [progress.steps_per_s for progress in reports[1:]] == pytest.approx([25.6] * 3)
    assert reports[0].measured == {
        "return": None,
        "policy_loss": 0.1,
        "value_loss": 0.2,
        "entropy": 1.5,
    }
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert lines[1] == {"update": 2, "steps": 512, "wall_s": 20.0} | reports[0].measured
    assert (result.steps, result.wall_s) == (1024, 40.0)
    assert result.summary == {
        "experiment": "lateral",
        "seed": 3,
        "steps": 1024,
        "wall_s": 40.0,
        "steps_per_s": 25.6,
    }


def test_resumed_training_continues_from_its_checkpoint(counting_updates, tmp_path):
    def interrupt(progress):
        if progress.steps == 512:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_experiment(TINY, 3, tmp_path, on_update=interrupt)
    reports = []
    result = train_experiment(TINY, 3, tmp_path, resume=True, on_update=reports.append)
    assert [progress.steps for progress in reports] == [768, 1024]
    assert np.isnan(reports[0].steps_per_s)
    assert reports[1].steps_per_s == pytest.approx(25.6)
    assert result.wall_s == 40.0


@pytest.mark.parametrize(("every_s", "saved"), [(20.0, [2, 4]), (25.0, [3]), (60.0, [])])
def test_saves_checkpoints_at_their_interval(
    counting_updates, tmp_path, monkeypatch, every_s, saved
):
    """At the end of training, there is always one more."""
    saved_updates = []
    monkeypatch.setattr(
        run, "save_checkpoint", lambda path, learner, _: saved_updates.append(int(learner.updates))
    )
    train_experiment(TINY, 3, tmp_path, checkpoint_every_s=every_s)
    assert saved_updates == [*saved, 4]


@pytest.mark.slow
def test_names_the_last_good_checkpoint(counting_updates, tmp_path, monkeypatch):
    original = run.run_updates

    def non_finite_entropy(*arguments):
        for number, learner, measured in original(*arguments):
            yield number, learner, measured | ({"entropy": np.nan} if number == 4 else {})

    monkeypatch.setattr(run, "run_updates", non_finite_entropy)
    message = "seed 3: entropy is not finite after 1024 steps; .*after 512 steps$"
    with pytest.raises(TrainingError, match=message):
        train_experiment(TINY, 3, tmp_path, checkpoint_every_s=20.0)


def test_policy_description_states_its_training(counting_updates, tmp_path):
    train_experiment(TINY, 3, tmp_path)
    description = json.loads((tmp_path / "policy.json").read_text())
    assert (description["experiment"], description["seed"], description["format"]) == (
        "lateral",
        3,
        1,
    )
    assert (description["task_name"], description["task_version"]) == ("lateral", 1)
    assert description["hidden"] == [2]
    assert description["observation"][:4] == ["theta_f_1", "theta_sf_1", "d_c_1", "delta_t_1"]
    assert description["actions"][0] == "none"
    assert (len(description["observation"]), len(description["actions"])) == (8, 5)
    assert description["config"]["ppo"]["hidden"] == [2]
    assert set(description["packages"]) == {"skystack", "jax", "jaxlib", "optax", "numpy"}
    assert description["packages"]["numpy"] == np.__version__
    # The initial weights, because nothing was learned.
    shapes = {name: value.shape for name, value in load_policy(tmp_path).tensors.items()}
    assert shapes["actor.0.weights"] == (8, 2)
    assert shapes["actor.1.weights"] == (2, 5)


def test_preflight_returns_notices(tmp_path):
    assert preflight(TINY, tmp_path / "new", False) == ["compiling ..."]
    assert preflight(TINY, tmp_path / "new", True) == [
        f"{tmp_path / 'new'} has no checkpoint: training starts from the beginning",
        "compiling ...",
    ]
    pretraining_only = small("pretraining.steps=1024")
    assert preflight(pretraining_only, tmp_path / "new", False) == [
        "pretraining.steps (1,024) covers all of ppo.total_steps (1,024): training uses "
        "pretraining.reward only, not task.reward",
        "compiling ...",
    ]
    assert preflight(small("pretraining.steps=1023"), tmp_path / "new", False) == ["compiling ..."]
    notices = preflight(small("task.cycles=100"), tmp_path / "new", False)
    assert len(notices) == 2
    assert "routes take more than 100 cycles" in notices[0]

    both = preflight(small("task.cycles=100", "pretraining.steps=1024"), tmp_path / "new", False)
    assert both[0].startswith("pretraining.steps (1,024)")
    assert both[1:] == notices


@pytest.mark.parametrize(
    ("script", "revision"),
    [
        ("echo 12ab", "12ab"),
        ("echo 12ab; echo why >&2; exit 128", None),  # no repository
    ],
)
def test_revision_is_that_of_git(tmp_path, monkeypatch, capfd, script, revision):
    git = tmp_path / "git"
    git.write_text(f"#!/bin/sh\n{script}\n")
    git.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    assert run._git_revision() == revision
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    assert run._git_revision() is None


def test_preflight_protects_earlier_trainings(tmp_path):
    preflight(TINY, tmp_path, False)
    (tmp_path / "checkpoint" / "learner.safetensors").write_bytes(b"half")
    with pytest.raises(InputError, match="contains an unfinished training run"):
        preflight(TINY, tmp_path, False)
    assert preflight(TINY, tmp_path, True) == ["compiling ..."]
    (tmp_path / "policy.json").write_text("{}")
    with pytest.raises(InputError, match="already contains a trained policy"):
        preflight(TINY, tmp_path, False)
    assert preflight(TINY, tmp_path, True) == ["compiling ..."]
