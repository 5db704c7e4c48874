"""Sector control on the command line: train a policy, fly hours of traffic, report mistakes."""

import json

import pytest

from tests.cli.test_cli import run

SMALL = [
    *("--set", "ppo.total_steps=64", "--set", "ppo.environments=4", "--set", "ppo.steps=8"),
    *("--set", "ppo.minibatch=32", "--set", "task.slots=8", "--set", "pretraining.steps=32"),
]


@pytest.mark.slow
def test_trains_a_policy_and_flies_an_hour_with_it(capsys, tmp_path):
    trained, out = tmp_path / "run", tmp_path / "hours"
    code, _, err = run(capsys, "train", "sector-control", "--out", str(trained), *SMALL)
    assert code == 0
    assert err.rstrip().endswith("--traffic 60")
    options = ["--traffic", "40", "--cycles", "20", "--out", str(out), "--json"]
    code, printed, err = run(capsys, "evaluate", str(trained), *options)
    assert code == 0
    row = json.loads(printed)["rows"][0]
    assert (row["agent"], row["traffic"]) == ("sector-control-s0", "40")
    (folder,) = out.iterdir()
    assert folder.name == "sector-control-s0-traffic-40-seed-0"
    names = ("aircraft", "clearances", "episodes", "losses", "trajectories")
    assert {path.name for path in folder.iterdir() if not path.name.startswith(".")} == {
        "row.json", *(f"{name}.parquet" for name in names)
    }  # fmt: skip
    assert "written" in err


def test_a_policy_of_sector_control_needs_traffic(capsys):
    code, _, err = run(capsys, "evaluate", "sector-control")
    assert code == 2
    assert "controls a whole sector (allowed: with --traffic, such as" in err


@pytest.mark.slow
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
        (["lateral", "--traffic", "60"], "trained on task lateral (allowed with this traffic:"),
        (["search", "--traffic", "0"], "flights per hour is 0.0 (allowed: above 0"),
        (["search", "--traffic", "-5"], "flights per hour is -5.0"),
        (
            ["search", "--traffic", "many"],
            "unknown traffic 'many' (allowed: flights per hour, cat",
        ),
        (["search", "--traffic", "60", "--sample"], "--sample cannot be used with --traffic"),
        (["search", "--traffic", "60", "--no-stacking"], "--no-stacking cannot be used"),
        (
            ["search", "--traffic", "60", "--platform", "bluebird"],
            "traffic 60 in BluebirdDT (allowed: category, notebook, environment, or",
        ),
        (["mvp", "--traffic", "60"], "mvp flies in BlueSky only (allowed: --platform bluesky)"),
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


@pytest.mark.slow
def test_hours_are_evaluated_replayed_and_reported(tmp_path, capsys):
    out, page, report = tmp_path / "hours", tmp_path / "replay.html", tmp_path / "hours.html"
    options = ["--traffic", "60.0", "--cycles", "40", "--out", str(out)]
    code, _, err = run(capsys, "evaluate", "rules", *options)
    assert code == 0
    folder = out / "rules-traffic-60-seed-0"
    assert f"replay {folder}" in err
    assert run(capsys, "replay", str(folder), "-o", str(page))[0] == 0
    assert run(capsys, "report", str(out), "-o", str(report))[0] == 0
    assert page.exists()
    assert report.exists()


@pytest.mark.slow
def test_hours_are_flown_in_bluebird(tmp_path, capsys):
    pytest.importorskip("bluebird_dt")
    out, page = tmp_path / "hours", tmp_path / "replay.html"
    options = ["--traffic", "category", "--platform", "bluebird", "--cycles", "40", "--json"]
    code, printed, _ = run(capsys, "evaluate", "own-navigation", *options, "--out", str(out))
    assert code == 0
    (row,) = json.loads(printed)["rows"]
    assert (row["platform"], row["traffic"]) == ("bluebird", "category")
    assert row["flights"] > 4
    assert row["transmissions_per_flight"] > 0.5
    folder = out / "own-navigation-traffic-category-seed-0-platform-bluebird"
    assert run(capsys, "replay", str(folder), "-o", str(page))[0] == 0
    assert "own-navigation, category traffic, in bluebird" in page.read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--traffic", "60"], "traffic 60 in BluebirdDT (allowed: category, notebook, environ"),
        (["--traffic", "category", "--uncertainty"], "--uncertainty cannot be used with --plat"),
        (["--traffic", "category", "--sector", "merge"], "--sector cannot be used with --plat"),
    ],
)
def test_what_bluebird_does_not_fly_is_refused(capsys, options, message):
    pytest.importorskip("bluebird_dt")
    code, _, err = run(capsys, "evaluate", "rules", "--platform", "bluebird", *options)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err


@pytest.mark.parametrize("option", [["--no-stacking"], ["--time-limit", "5"]])
def test_options_for_scenarios_are_refused_with_traffic(capsys, option):
    code, _, err = run(capsys, "evaluate", "rules", "--traffic", "60", *option)
    assert code == 2
    assert f"{option[0]} cannot be used with --traffic" in err


def test_the_safety_net_is_for_traffic(capsys):
    code, _, err = run(capsys, "evaluate", "lateral", "--no-safety-net")
    assert code == 2
    assert "--no-safety-net needs --traffic" in err
