"""The shipped examples run, with small arguments."""

import json
import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def run(monkeypatch, capsys):
    """Run an example and return the numbers that it prints, unstacked and stacked."""

    def example(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        lines = dict(line.split(": ") for line in capsys.readouterr().out.splitlines())
        assert list(lines) == ["one at a time", "stacked"]
        return [[float(number) for number in re.findall(r"[\d.]+", lines[way])] for way in lines]

    return example


def test_thermostat_gets_one_stacked_message(run):
    """From 17 to 21 degrees takes eight steps of half a degree, or one stacked message.

    With the dial set to 21 at once, the room is off by 4 * 0.7 ** cycle.
    """
    (slow, off_slow), (fast, off_fast) = run("thermostat.py")
    assert (slow, fast) == (8, 1)
    expected = sum(4.0 * 0.7**cycle for cycle in range(1, 31)) / 30.0
    assert off_fast == pytest.approx(expected, abs=0.006)
    assert off_slow > off_fast


@pytest.mark.slow
def test_rule_reaches_all_exits(run):
    (plain, success), (stacked, stacked_success) = run("rule.py", "--scenarios", "3")
    assert (success, stacked_success) == (100, 100)
    assert 0 < stacked < plain


@pytest.mark.slow
def test_evaluated_rule_reaches_all_exits(run, tmp_path):
    few = ("--scenarios", "3", "--out", str(tmp_path))
    (plain, success), (stacked, stacked_success) = run("evaluated_rule.py", *few)
    assert (success, stacked_success) == (100, 100)
    assert 0 < stacked < plain
    assert {path.name for path in tmp_path.iterdir()} == {
        "aim-s0-skystack-plain",
        "aim-s0-skystack-stacked",
    }


@pytest.mark.slow
def test_stacks_a_stable_baselines3_policy(run):
    """Actions are drawn, because after so short a training the most probable one may be none."""
    pytest.importorskip("stable_baselines3")
    small = ("--steps", "1024", "--environments", "16", "--sample")
    for issued, success in run("sb3_stacked.py", *small):
        assert issued > 0
        assert 0 <= success <= 100


def recording(calls):
    """Modules with the functions that the example calls of trackio and mlflow."""

    def log(values, step):
        calls.append(("log", values, step))

    def call(name):
        return lambda *words, **options: calls.append((name, *words, options))

    return {
        "trackio": SimpleNamespace(init=call("init"), log=log, finish=call("finish")),
        "mlflow": SimpleNamespace(
            set_experiment=call("set_experiment"),
            start_run=call("start_run"),
            log_metrics=log,
            end_run=call("end_run"),
        ),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tracker", "begin", "end"),
    [
        ("trackio", [("init", {"project": "skystack", "name": "vertical-s0"})], "finish"),
        (
            "mlflow",
            [("set_experiment", "skystack", {}), ("start_run", {"run_name": "vertical-s0"})],
            "end_run",
        ),
    ],
)
def test_trackers_get_every_update(tracker, begin, end, monkeypatch, capsys, tmp_path):
    """Their modules are replaced: the libraries are too large for the test environment."""
    calls = []
    monkeypatch.setitem(sys.modules, tracker, recording(calls)[tracker])
    small = ("total_steps=1024", "environments=8", "steps=64", "minibatch=64", "epochs=1")
    words = [word for setting in small for word in ("--set", f"ppo.{setting}")]
    words += ["--set", "task.cycles=104", "--out", str(tmp_path), "--tracker", tracker]
    monkeypatch.setattr(sys, "argv", ["tracked_training.py", "vertical", *words])
    runpy.run_path(str(EXAMPLES / "tracked_training.py"), run_name="__main__")
    assert capsys.readouterr().out == f"policy: {tmp_path / 'policy.json'}\n"
    assert (tmp_path / "policy.safetensors").exists()
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert calls[: len(begin)] == begin
    assert calls[-1] == (end, {})
    logged = calls[len(begin) : -1]
    assert len(logged) == len(lines) == 2
    assert any(line["success"] is None for line in lines)
    for (_, values, step), line in zip(logged, lines, strict=True):
        assert step == line["steps"]
        when = ("update", "steps", "wall_s")
        assert values == {
            name: value for name, value in line.items() if value is not None and name not in when
        }
