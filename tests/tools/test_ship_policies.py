"""Shipping policies of a run: which are taken, what is refused and what is written."""

import json
import shutil

import pytest

from skystack.evaluation.evaluate import Conditions
from skystack.policies import shipped
from skystack.policies.measured import read_measured
from tools import ship_policies

SHIPPED = shipped.SHIPPED
FILES = {"policy.json", "policy.safetensors", "measured.json", "README.md"}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An empty package, with evaluations of few scenarios."""
    few = (Conditions(episodes=2, stacking=False), Conditions(episodes=3))
    monkeypatch.setattr(ship_policies, "CONDITIONS", few)
    folder = tmp_path / "policies"
    folder.mkdir()
    monkeypatch.setattr(shipped, "SHIPPED", folder)
    return folder


def write_training(run, name, seed, **changes):
    """A training folder in a run, with a copy of a shipped policy as if of another seed."""
    folder = run / "train" / f"{name}-s{seed}"
    folder.mkdir(parents=True)
    for file in ("policy.json", "policy.safetensors"):
        shutil.copy(SHIPPED / name / file, folder)
    described = json.loads((folder / "policy.json").read_text()) | {"seed": seed} | changes
    (folder / "policy.json").write_text(json.dumps(described))
    return folder


def test_ships_the_lowest_seed_with_numbers_and_card(tmp_path, package):
    run = tmp_path / "run"
    for seed in (10, 2, 3):
        write_training(run, "vertical", seed)
    assert ship_policies.main([str(run)]) == 0
    folder = package / "vertical"
    assert {path.name for path in folder.iterdir()} == FILES
    policy = shipped.find_policy("vertical")
    assert policy.description.seed == 2
    found = read_measured(folder)
    assert found.sha256 == policy.description.sha256
    assert [row["episodes"] for row in found.rows] == [2, 3]
    assert [row["command"] for row in found.rows] == [
        "skystack evaluate vertical --episodes 2 --seed 0 --no-stacking --json",
        "skystack evaluate vertical --episodes 3 --seed 0 --stacking --json",
    ]
    assert "--seed 2" in (folder / "README.md").read_text()


def test_rewrites_cards_without_evaluating(package, monkeypatch):
    shutil.copytree(SHIPPED / "vertical", package / "vertical")
    card = package / "vertical" / "README.md"
    card.write_text("old")
    monkeypatch.setattr(ship_policies, "evaluate", None)
    assert ship_policies.main(["--cards"]) == 0
    assert card.read_text() == (SHIPPED / "vertical" / "README.md").read_text()
    numbers = (package / "vertical" / "measured.json").read_bytes()
    assert numbers == (SHIPPED / "vertical" / "measured.json").read_bytes()


def test_measuring_does_not_change_the_policy(package):
    shutil.copytree(SHIPPED / "vertical", package / "vertical")
    before = (package / "vertical" / "policy.json").stat()
    assert ship_policies.main(["--measure", "vertical"]) == 0
    assert [row["episodes"] for row in read_measured(package / "vertical").rows] == [2, 3]
    assert (package / "vertical" / "policy.json").stat().st_mtime_ns == before.st_mtime_ns


def write_faulty_run(run):
    """A run with one fault of each kind."""
    write_training(run, "lateral", 0)
    (write_training(run, "lateral-best", 0) / "policy.safetensors").unlink()
    quick = json.loads((SHIPPED / "lateral-tuned" / "policy.json").read_text())["config"]
    quick["ppo"]["total_steps"] = 1000
    write_training(run, "lateral-tuned", 0, config=quick)
    write_training(run, "vertical", 4).rename(run / "train" / "vertical-s0")
    write_training(run, "lateral-large", 1)
    (run / "train" / "lateral-large-s0").mkdir()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "RUN is missing"),
        (["{run}/nowhere"], "has no train/<experiment>-s<seed>"),
        (["{run}", "laterl"], "unknown policy of {run} 'laterl'; did you mean 'lateral'?"),
        (["{run}", "lateral-best"], "lateral-best-s0/policy.safetensors: cannot be read"),
        (["{run}", "lateral-tuned"], "other settings than experiment lateral-tuned (ppo)"),
        (["{run}", "vertical"], "contains vertical, seed 4"),
        (["{run}", "lateral-large"], "lateral-large-s0/policy.json: cannot be read"),
        (["--measure", "lateral"], "unknown policy of the package 'lateral'"),
        (["--cards", "avoidance-best"], "missing, or measured with another policy (use --measure)"),
    ],
)
def test_reports_faults_in_one_line_and_writes_nothing(
    tmp_path, package, capsys, arguments, message
):
    run = tmp_path / "run"
    write_faulty_run(run)
    shutil.copytree(SHIPPED / "avoidance-best", package / "avoidance-best")
    (package / "avoidance-best" / "measured.json").unlink()
    before = sorted(package.rglob("*"))
    formatted = [argument.format(run=run) for argument in arguments]
    assert ship_policies.main(formatted) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert message.format(run=run) in error
    assert sorted(package.rglob("*")) == before


@pytest.mark.parametrize("words", [["--foo"], ["--measure", "--cards"]])
def test_wrong_options_give_one_line(words, capsys):
    assert ship_policies.main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_checks_all_policies_before_it_ships_one(tmp_path, package):
    write_training(tmp_path / "run", "lateral", 0)
    write_training(tmp_path / "run", "vertical", 0, sha256="0" * 64)
    assert ship_policies.main([str(tmp_path / "run")]) == 2
    assert not list(package.iterdir())
