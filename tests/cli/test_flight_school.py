"""The verb `flight-school`."""

import json

import pytest

from skystack.cli.arguments import parse
from skystack.cli.flight_school import OPTIONS, _again
from skystack.cli.output import program
from tests.cli.test_cli import run

PROMISED = {
    "agent", "traffic", "platform", "seeds", "lax_s_mean", "lax_s_by_seed", "strict_s_mean",
    "lax_without_births_s_mean", "deliveries", "flights", "losses_of_separation",
    "transmissions_per_flight", "decision_ms_median",
}  # fmt: skip


def fly(capsys, out, *options):
    few = ("--seeds", "2", "--cycles", "30", "--traffic", "60", "--out", str(out))
    return run(capsys, "flight-school", *few, *options)


@pytest.mark.slow
def test_prints_a_table_and_writes_the_hours(capsys, tmp_path):
    code, out, err = fly(capsys, tmp_path / "out", "noop", "--strict")
    assert code == 0
    assert "survival (%) at" in out
    assert "(strict)" in out
    assert max(map(len, out.splitlines())) <= 80
    folder = tmp_path / "out" / "no-op-flight-school-60-cycles-30"
    assert f"written: {folder}" in err
    assert (folder / "aircraft.parquet").exists()
    code, _, err = run(capsys, "replay", str(folder), "-o", str(tmp_path / "replay.html"))
    assert code == 0, err
    assert "2 scenarios" in err
    code, out, err = run(
        capsys, "report", str(tmp_path / "out"), "-o", str(tmp_path / "hours.html")
    )
    assert code == 0, err
    assert "no-op" in out


@pytest.mark.slow
def test_the_row_has_what_is_promised(capsys, tmp_path):
    options = ("own-navigation", "--first-seed", "7", "--json")
    code, out, _ = fly(capsys, tmp_path, *options)
    assert code == 0
    (row,) = json.loads(out)["rows"]
    assert set(row) >= PROMISED
    assert (row["traffic"], row["seeds"], row["seed_numbers"]) == ("60", 2, [7, 8])
    assert len(row["lax_s_by_seed"]) == 2
    code, again, err = fly(capsys, tmp_path, *options)
    assert json.loads(again)["rows"] == [row]
    assert "already flown: 2 of 2 seeds" in err


@pytest.mark.slow
def test_failed_seeds_are_named(capsys, tmp_path):
    code, out, err = fly(capsys, tmp_path, "tests/agents/user_controllers.py:NoSuchFlight")
    assert (code, out) == (2, "")
    last = err.splitlines()[-1]
    assert last.endswith("all seeds failed: seed 0, cycle 0, BAW12: unknown callsign")


@pytest.mark.slow
def test_the_example_in_the_documentation_flies(capsys, tmp_path):
    """It changes levels at once, so it delivers flights, and loses separation."""
    options = ("--traffic", "30", "--json", "--seeds", "1", "--cycles", "200")
    agent = "examples/own_controller.py:ToExitLevel"
    code, out, err = run(capsys, "flight-school", agent, *options, "--out", str(tmp_path))
    assert code == 0, err
    (row,) = json.loads(out)["rows"]
    assert row["agent"] == "own_controller.ToExitLevel"
    assert row["deliveries"] > 0
    assert row["transmissions_per_flight"] <= 2.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["serch"], "unknown agent 'serch'; did you mean 'search'?"),
        (["no_module:Mine"], "no_module:Mine: there is no module no_module"),
        (["noop", "--traffic", "-5"], "flights per hour is -5.0"),
        (["noop", "--platform", "bluesk"], "unknown platform 'bluesk'"),
        (["mvp"], "mvp flies in BlueSky only"),
        (["noop", "--platform", "bluebird", "--traffic", "60"], "traffic 60 in BluebirdDT"),
        (["noop", "--no-safety-net"], "no-op has no safety net"),
        (["noop", "--seeds", "0"], "--seeds: '0' (allowed: whole numbers from 1)"),
        (["missing.onnx"], "missing.onnx"),
    ],
)
def test_mistakes_give_one_line_and_exit_code_2(capsys, tmp_path, arguments, message):
    out = tmp_path / "out"
    code, printed, err = run(capsys, "flight-school", *arguments, "--out", str(out))
    assert (code, printed, err.count("\n")) == (2, "", 1)
    assert message in err
    assert not out.exists()


def test_the_line_that_resumes_has_all_options_that_differ():
    line = ["flight-school", "search", "--seeds", "9", "--strict", "--no-safety-net"]
    assert _again(parse(line)) == f"{program()} " + " ".join(line)
    assert set(OPTIONS) <= set(vars(parse(line)))
