"""Training runs: their files, repetition, resumption, interruption, curriculum."""

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
        for number, updated, measured in run_updates(updates, settings, learner):
            broken = jax.tree.map(lambda leaf: leaf * np.nan, updated.parameters)
            yield number, updated._replace(parameters=broken) if number == 3 else updated, measured

    monkeypatch.setattr(run, "run_updates", spoiled)
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
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "learner.safetensors").touch()
    for attempt in (
        lambda: train_experiment(small(), 3, tmp_path),
        lambda: preflight(small(), tmp_path, resume=False),  # though it holds an unfinished one
    ):
        with (
            locked_folder(tmp_path),
            pytest.raises(InputError, match=f"^{tmp_path}: is in use by another process"),
        ):
            attempt()
    assert not (tmp_path / "metrics.jsonl").exists()


def test_a_seed_out_of_range_is_refused(tmp_path):
    for seed in (-1, 2**31):
        with pytest.raises(
            InputError, match=r"^seed is .* \(allowed: whole numbers from 0 to 2147"
        ):
            train_experiment(small(), seed, tmp_path / "run")
    assert not (tmp_path / "run").exists()


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


class Clock:
    """Time that passes by ten seconds an update."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now


@pytest.fixture
def untrained(monkeypatch):
    """Trainings that learn nothing: updates are counted, and measured as nothing in particular."""
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


def test_a_task_with_several_agents_is_refused(tmp_path, monkeypatch):
    """The learner knows one agent; nothing is written."""
    monkeypatch.setattr(NavigationTask, "agents", 2)
    experiment = load_experiment("lateral")
    for refused in (
        lambda: train_experiment(experiment, 0, tmp_path / "run"),
        lambda: preflight(experiment, tmp_path / "run", False),
    ):
        with pytest.raises(InputError, match=r"^task lateral has 2 agents \(allowed"):
            refused()
    assert list(tmp_path.iterdir()) == []


def test_progress_is_reported_after_every_update(untrained, tmp_path):
    """256 steps in ten seconds; the first update is not counted, as it waits for its program."""
    told = []
    ended = train_experiment(TINY, 3, tmp_path, on_update=told.append)
    assert [progress.steps for progress in told] == [256, 512, 768, 1024]
    assert {progress.total_steps for progress in told} == {1024}
    assert np.isnan(told[0].steps_per_s)
    assert [progress.steps_per_s for progress in told[1:]] == pytest.approx([25.6] * 3)
    assert told[0].measured == {
        "return": None,
        "policy_loss": 0.1,
        "value_loss": 0.2,
        "entropy": 1.5,
    }
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert lines[1] == {"update": 2, "steps": 512, "wall_s": 20.0} | told[0].measured
    assert (ended.steps, ended.wall_s) == (1024, 40.0)
    assert ended.summary == {
        "experiment": "lateral",
        "seed": 3,
        "steps": 1024,
        "wall_s": 40.0,
        "steps_per_s": 25.6,
    }


def test_resumed_training_counts_from_its_checkpoint(untrained, tmp_path):
    def interrupt(progress):
        if progress.steps == 512:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_experiment(TINY, 3, tmp_path, on_update=interrupt)
    told = []
    ended = train_experiment(TINY, 3, tmp_path, resume=True, on_update=told.append)
    assert [progress.steps for progress in told] == [768, 1024]
    assert np.isnan(told[0].steps_per_s)
    assert told[1].steps_per_s == pytest.approx(25.6)
    assert ended.wall_s == 40.0


@pytest.mark.parametrize(("every_s", "saved"), [(20.0, [2, 4]), (25.0, [3]), (60.0, [])])
def test_checkpoints_come_when_their_time_has_passed(
    untrained, tmp_path, monkeypatch, every_s, saved
):
    """Those of the training: at the end there is always one more."""
    written = []
    monkeypatch.setattr(
        run, "save_checkpoint", lambda path, learner, _: written.append(int(learner.updates))
    )
    train_experiment(TINY, 3, tmp_path, checkpoint_every_s=every_s)
    assert written == [*saved, 4]


def test_the_last_good_checkpoint_is_named(untrained, tmp_path, monkeypatch):
    spoilt = run.run_updates

    def spoil(*given):
        for number, learner, measured in spoilt(*given):
            yield number, learner, measured | ({"entropy": np.nan} if number == 4 else {})

    monkeypatch.setattr(run, "run_updates", spoil)
    message = "seed 3: entropy is not finite after 1024 steps; .*after 512 steps$"
    with pytest.raises(TrainingError, match=message):
        train_experiment(TINY, 3, tmp_path, checkpoint_every_s=20.0)


def test_a_policy_is_described_by_its_training(untrained, tmp_path):
    train_experiment(TINY, 3, tmp_path)
    described = json.loads((tmp_path / "policy.json").read_text())
    assert (described["experiment"], described["seed"], described["format"]) == ("lateral", 3, 1)
    assert (described["task_name"], described["task_version"]) == ("lateral", 1)
    assert described["hidden"] == [2]
    assert described["observation"][:4] == ["theta_f_1", "theta_sf_1", "d_c_1", "delta_t_1"]
    assert described["actions"][0] == "none"
    assert (len(described["observation"]), len(described["actions"])) == (8, 5)
    assert described["config"]["ppo"]["hidden"] == [2]
    assert set(described["packages"]) == {"skystack", "jax", "jaxlib", "optax", "numpy"}
    assert described["packages"]["numpy"] == np.__version__
    # Its first weights, since nothing was learned.
    weights = {name: value.shape for name, value in load_policy(tmp_path).tensors.items()}
    assert weights["actor.0.weights"] == (8, 2)
    assert weights["actor.1.weights"] == (2, 5)


def test_notices_before_a_training_begins(tmp_path):
    assert preflight(TINY, tmp_path / "new", False) == ["compiling ..."]
    assert preflight(TINY, tmp_path / "new", True) == [
        f"{tmp_path / 'new'} has no checkpoint: training starts from the beginning",
        "compiling ...",
    ]
    all_of_it = small("pretraining.steps=1024")
    assert preflight(all_of_it, tmp_path / "new", False) == [
        "pretraining.steps (1,024) covers all of ppo.total_steps (1,024): training uses "
        "pretraining.reward only, not task.reward",
        "compiling ...",
    ]
    assert preflight(small("pretraining.steps=1023"), tmp_path / "new", False) == ["compiling ..."]
    said = preflight(small("task.cycles=100"), tmp_path / "new", False)
    assert len(said) == 2
    assert "routes take more than 100 cycles" in said[0]

    both = preflight(small("task.cycles=100", "pretraining.steps=1024"), tmp_path / "new", False)
    assert both[0].startswith("pretraining.steps (1,024)")
    assert both[1:] == said


@pytest.mark.parametrize(
    ("script", "revision"),
    [
        ("echo 12ab", "12ab"),
        ("echo 12ab; echo why >&2; exit 128", None),  # no repository
    ],
)
def test_the_revision_is_that_of_git(tmp_path, monkeypatch, capfd, script, revision):
    git = tmp_path / "git"
    git.write_text(f"#!/bin/sh\n{script}\n")
    git.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    assert run._git_revision() == revision
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    assert run._git_revision() is None


def test_no_training_is_lost_to_another(tmp_path):
    preflight(TINY, tmp_path, False)
    (tmp_path / "checkpoint" / "learner.safetensors").write_bytes(b"half")
    with pytest.raises(InputError, match="contains an unfinished training run"):
        preflight(TINY, tmp_path, False)
    assert preflight(TINY, tmp_path, True) == ["compiling ..."]
    (tmp_path / "policy.json").write_text("{}")
    with pytest.raises(InputError, match="already contains a trained policy"):
        preflight(TINY, tmp_path, False)
    assert preflight(TINY, tmp_path, True) == ["compiling ..."]
