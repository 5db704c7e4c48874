"""Shipping: which policy of a run is taken, what is refused, what is written."""

import json
import shutil

import pytest

from skystack.evaluation.evaluate import Conditions
from skystack.policies import shipped
from skystack.policies.measured import read_measured
from tools import ship_policies

SHIPPED = shipped.SHIPPED
FILES = {"policy.json", "policy.safetensors", "measured.json", "card.md"}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An empty package, and few scenarios."""
    few = (Conditions(episodes=2, stacking=False), Conditions(episodes=3))
    monkeypatch.setattr(ship_policies, "CONDITIONS", few)
    folder = tmp_path / "policies"
    folder.mkdir()
    monkeypatch.setattr(shipped, "SHIPPED", folder)
    return folder


def trained(run, name, seed, **changes):
    """A folder of a run that holds a copy of a shipped policy, as if of another seed."""
    folder = run / "train" / f"{name}-s{seed}"
    folder.mkdir(parents=True)
    for file in ("policy.json", "policy.safetensors"):
        shutil.copy(SHIPPED / name / file, folder)
    described = json.loads((folder / "policy.json").read_text()) | {"seed": seed} | changes
    (folder / "policy.json").write_text(json.dumps(described))
    return folder


def test_the_lowest_seed_ships_with_numbers_and_card(tmp_path, package):
    run = tmp_path / "run"
    for seed in (10, 2, 3):
        trained(run, "vertical", seed)
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
    assert "--seed 2" in (folder / "card.md").read_text()


def test_cards_are_written_anew_without_flying(package, monkeypatch):
    shutil.copytree(SHIPPED / "vertical", package / "vertical")
    card = package / "vertical" / "card.md"
    card.write_text("old")
    monkeypatch.setattr(ship_policies, "evaluate", None)
    assert ship_policies.main(["--cards"]) == 0
    assert card.read_text() == (SHIPPED / "vertical" / "card.md").read_text()
    numbers = (package / "vertical" / "measured.json").read_bytes()
    assert numbers == (SHIPPED / "vertical" / "measured.json").read_bytes()


def test_measuring_leaves_the_policy(package):
    shutil.copytree(SHIPPED / "vertical", package / "vertical")
    before = (package / "vertical" / "policy.json").stat()
    assert ship_policies.main(["--measure", "vertical"]) == 0
    assert [row["episodes"] for row in read_measured(package / "vertical").rows] == [2, 3]
    assert (package / "vertical" / "policy.json").stat().st_mtime_ns == before.st_mtime_ns


def prepared(run):
    """A run with one fault of each kind."""
    trained(run, "lateral", 0)
    (trained(run, "lateral-best", 0) / "policy.safetensors").unlink()
    quick = json.loads((SHIPPED / "lateral-tuned" / "policy.json").read_text())["config"]
    quick["ppo"]["total_steps"] = 1000
    trained(run, "lateral-tuned", 0, config=quick)
    trained(run, "vertical", 4).rename(run / "train" / "vertical-s0")
    trained(run, "lateral-large", 1)
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
def test_what_is_missing_is_named_and_nothing_written(
    tmp_path, package, capsys, arguments, message
):
    run = tmp_path / "run"
    prepared(run)
    shutil.copytree(SHIPPED / "avoidance-best", package / "avoidance-best")
    (package / "avoidance-best" / "measured.json").unlink()
    before = sorted(package.rglob("*"))
    named = [argument.format(run=run) for argument in arguments]
    assert ship_policies.main(named) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert told.count("\n") == 1
    assert message.format(run=run) in told
    assert sorted(package.rglob("*")) == before
