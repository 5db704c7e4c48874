"""The examples run as they are shipped, with little to do."""

import re
import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def run(monkeypatch, capsys):
    """What an example prints: the numbers of its line for each way, and nothing else."""

    def example(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        lines = dict(line.split(": ") for line in capsys.readouterr().out.splitlines())
        assert list(lines) == ["one at a time", "stacked"]
        return [[float(number) for number in re.findall(r"[\d.]+", lines[way])] for way in lines]

    return example


def test_the_thermostat_is_told_once(run):
    """From 17 to 21 degrees by halves are eight messages, or one; told at once it is warm sooner.

    With the dial at 21 at once the room is off by 4 * 0.7 ** cycle.
    """
    (slow, off_slow), (fast, off_fast) = run("thermostat.py")
    assert (slow, fast) == (8, 1)
    expected = sum(4.0 * 0.7**cycle for cycle in range(1, 31)) / 30.0
    assert off_fast == pytest.approx(expected, abs=0.006)
    assert off_slow > off_fast


def test_the_rule_brings_everybody_out(run):
    (plain, success), (stacked, stacked_success) = run("rule.py", "--scenarios", "3")
    assert (success, stacked_success) == (100, 100)
    assert 0 < stacked < plain


def test_the_judged_rule_brings_everybody_out(run, tmp_path):
    few = ("--scenarios", "3", "--out", str(tmp_path))
    (plain, success), (stacked, stacked_success) = run("judged_rule.py", *few)
    assert (success, stacked_success) == (100, 100)
    assert 0 < stacked < plain
    assert {path.name for path in tmp_path.iterdir()} == {
        "aim-s0-skystack-plain",
        "aim-s0-skystack-stacked",
    }


def test_a_policy_of_stable_baselines3_is_stacked(run):
    pytest.importorskip("stable_baselines3")
    small = ("--steps", "1024", "--environments", "16")
    for issued, success in run("sb3_stacked.py", *small):
        assert issued > 0
        assert 0 <= success <= 100
