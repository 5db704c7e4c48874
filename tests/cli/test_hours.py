"""Sector control on the command line: train a policy, fly hours of traffic, report mistakes."""

import json

import pytest

from tests.cli.test_cli import run

SMALL = [
    *("--set", "ppo.total_steps=64", "--set", "ppo.environments=4", "--set", "ppo.steps=8"),
    *("--set", "ppo.minibatch=32", "--set", "task.slots=8", "--set", "pretraining.steps=32"),
]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return tmp_path_factory.mktemp("control") / "run"


def test_trains_a_policy_and_flies_an_hour_with_it(capsys, trained):
    code, _, err = run(capsys, "train", "sector-control", "--out", str(trained), *SMALL)
    assert code == 0
    assert err.rstrip().endswith("--traffic 60")
    out = trained.parent / "hours"
    options = ["--traffic", "40", "--cycles", "20", "--out", str(out), "--json"]
    code, printed, err = run(capsys, "evaluate", str(trained), *options)
    assert code == 0
    row = json.loads(printed)["rows"][0]
    assert (row["agent"], row["traffic"]) == ("sector-control", "40")
    assert {path.name for path in out.iterdir()} == {
        f"{name}.parquet" for name in ("flights", "hours", "losses", "transmissions")
    }
    assert "written" in err


def test_a_policy_of_sector_control_needs_traffic(capsys, trained):
    code, _, err = run(capsys, "evaluate", str(trained))
    assert code == 2
    assert "controls a whole sector (allowed: with --traffic, such as" in err


def test_prints_a_table_for_other_agents(capsys):
    options = ["--traffic", "category", "--cycles", "10", "--uncertainty", "--per-cycle", "3"]
    code, out, _ = run(capsys, "evaluate", "own-navigation", *options)
    assert code == 0
    for text in ("transmissions per flight", "fail-safe cycles", "lax score"):
        assert text in out
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["search"], "search controls a whole sector"),
        (["serch", "--traffic", "60"], "unknown agent 'serch'; did you mean 'search'?"),
        (["lateral", "--traffic", "60"], "trained on task lateral (allowed with --traffic:"),
        (["search", "--traffic", "0"], "flights per hour is 0.0 (allowed: above 0"),
        (["search", "--traffic", "-5"], "flights per hour is -5.0"),
        (["search", "--traffic", "many"], "traffic 'many' (allowed: flights per hour, or"),
        (["search", "--traffic", "60", "--sample"], "--sample cannot be used with --traffic"),
        (["search", "--traffic", "60", "--no-stacking"], "--no-stacking cannot be used"),
        (["search", "--traffic", "60", "--platform", "bluesky"], "--platform cannot be used"),
        (["search", "--traffic", "60", "--sector", "x-pluss"], "did you mean 'x-plus'"),
        (["lateral", "--per-cycle", "2"], "--per-cycle needs --traffic"),
        (["lateral", "--uncertainty"], "--uncertainty needs --traffic"),
    ],
)
def test_mistakes_give_one_line_and_exit_code_2(capsys, arguments, message):
    code, out, err = run(capsys, "evaluate", *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("task.flights_per_hour=[90.0,30.0]", "task.flights_per_hour is 90 to 30"),
        ("task.flights_per_hour=[-1.0,30.0]", "task.flights_per_hour"),
        ("task.slots=1", "task.slots"),
        ("task.reward.los=1.0", "did you mean 'task.reward.loss'"),
    ],
)
def test_impossible_settings_are_refused(capsys, tmp_path, change, message):
    out = str(tmp_path / "run")
    code, _, err = run(capsys, "train", "sector-control", "--set", change, "--out", out)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert not (tmp_path / "run").exists()
