"""The comparison with another installed version, with programs that stand for the two Pythons."""

import json
import math
import os
import sys
from pathlib import Path

import pytest

import skystack
from skystack.benchmarking import installations
from skystack.benchmarking.display import pairs_table
from skystack.benchmarking.groups import GROUPS
from skystack.benchmarking.machine import Machine
from skystack.benchmarking.paired import Measurements, Pair, compare_with
from skystack.benchmarking.run import QUICK, Effort, groups_of, parts
from skystack.cli import main
from skystack.errors import InputError, TrainingError

PROGRAM = """
import json, os, sys
sys.stdout.reconfigure(encoding="utf-8", errors="surrogateescape")
assert sys.argv[1:4] == ["-m", "skystack", "bench"], sys.argv
arguments = sys.argv[4:]
if "--help" in arguments:
    print({help!r})
    print("reason", file=sys.stderr)
    sys.exit({help_code})
with open({log!r}, "a") as log:
    variables = [os.environ.get(name, "-") for name in ("PYTHONPATH", "PYTHONHOME")]
    print({name!r}, *arguments, *variables, file=log)
count = sum(line.startswith({name!r}) for line in open({log!r}))
print("last words", file=sys.stderr)
print({output!r} or json.dumps({{
    "machine": {machine!r},
    "figures": [
        {{"name": name, "unit": unit, "values": [factor * count] * 2, "configuration": {work!r}}}
        for name, (unit, factor) in {figures!r}.items()
    ],
}}))
sys.exit({code})
"""
INTERPRETER = sys.executable
MACHINE = {
    "system": "Linux",
    "processor": "a processor",
    "cores": 2,
    "python": "3.11",
    "packages": {"skystack": "0.1.0"},
    "date": "2026-11-29",
}


@pytest.fixture
def python(tmp_path, monkeypatch):
    """Makes a program that stands for a Python whose skystack measures some figures.

    In its first run, each figure has its factor as its value, in the second one twice that.
    """
    monkeypatch.setenv("PYTHONPATH", "ours")
    monkeypatch.setenv("PYTHONHOME", "ours")

    def make(name, figures, **parts):
        file, program = tmp_path / name, tmp_path / f"{name}.py"
        standard = {
            "help": "[--only GROUP]",
            "help_code": 0,
            "output": "",
            "code": 0,
            "work": "alike",
            "machine": MACHINE | {"processor": name},
            "log": str(tmp_path / "log"),
        }
        program.write_text(PROGRAM.format(name=name, figures=figures, **(standard | parts)))
        file.write_text(f'#!/bin/sh\nexec "{INTERPRETER}" -E "{program}" "$@"\n')
        file.chmod(0o755)
        return str(file)

    return make


@pytest.fixture
def ours(python, monkeypatch):
    figures = {"speed": ("steps/s", 30.0), "start": ("s", 2.0), "new": ("s", 1.0)}
    monkeypatch.setattr(sys, "executable", python("ours", figures))


@pytest.fixture
def other(python):
    return python("other", {"speed": ("steps/s", 10.0), "start": ("s", 8.0), "old": ("s", 1.0)})


def test_a_ratio_above_one_is_better_for_rates_and_for_times():
    ours, theirs = (
        Measurements(((10.0, 30.0), (40.0, 20.0))),
        Measurements(((5.0, 5.0, 5.0), (10.0,))),
    )
    rate, time = (Pair("any", unit, ours, theirs) for unit in ("steps/s", "s"))
    assert (rate.ratio, rate.ratios) == (25.0 / 5.0, (20.0 / 5.0, 30.0 / 10.0))
    assert (time.ratio, time.ratios) == (5.0 / 25.0, (5.0 / 20.0, 10.0 / 30.0))
    (line,) = pairs_table([rate]).rows
    assert line == ("any", "25.0", "5.00", "steps/s", "5.00", "4.00, 3.00")


@pytest.mark.usefixtures("ours")
def test_both_are_measured_in_turn_and_the_other_without_our_packages(other, tmp_path):
    titles = []
    compared = compare_with(other, ["start", "simulator"], ["--quick"], titles.append)
    log = [line.split() for line in (tmp_path / "log").read_text().splitlines()]
    assert [line[0] for line in log] == ["ours", "other", "other", "ours"] * 2
    source = str(Path(skystack.__file__).parents[1])
    ours = ["--json", "--quick", "--only", "start", f"{source}{os.pathsep}ours", "ours"]
    assert log[0] == ["ours", *ours]
    assert log[5] == ["other", "--json", "--quick", "--only", "simulator", "-", "-"]
    assert titles[:2] == ["start, this version", "start, the other version"]
    assert len(titles) == 8
    assert compared.machine == Machine(**MACHINE | {"processor": "ours"})
    assert compared.other_machine == Machine(**MACHINE | {"processor": "other"})
    assert compared.unpaired == ["new", "old"] * 2
    speed, start = compared.pairs[:2]
    assert (speed.name, speed.ratio, speed.ratios) == ("speed", 3.0, (3.0, 3.0))
    assert speed.ours.rounds == ((30.0, 30.0), (60.0, 60.0))
    assert (start.name, start.ratio, start.same_work) == ("start", 4.0, True)


def test_a_training_run_without_success_takes_forever(python, monkeypatch):
    monkeypatch.setattr(sys, "executable", python("ours", {"success": ("s", 5.0)}))
    figure = {"name": "success", "unit": "s", "values": [None, 8.0, 9.0], "configuration": ""}
    output = json.dumps({"machine": MACHINE, "figures": [figure]})
    (pair,) = compare_with(python("other", {}, output=output), ["start"], [], print).pairs
    assert pair.theirs.rounds == ((math.inf, 8.0, 9.0),) * 2
    assert pair.as_json["other_values"] == ((None, 8.0, 9.0),) * 2
    assert pair.ratios == (9.0 / 5.0, 9.0 / 10.0)
    assert not pair.same_work  # another configuration


@pytest.mark.usefixtures("ours")
def test_the_command_prints_both_and_their_ratio(other, capsys):
    arguments = ["bench", "--quick", "--only", "start", "--against", other]
    assert main([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    speed = found["pairs"][0]
    assert (speed["name"], speed["ratio"], speed["ratios"]) == ("speed", 3.0, [3.0, 3.0])
    assert speed["other_values"] == [[10.0, 10.0], [20.0, 20.0]]
    assert found["unpaired"] == ["new", "old"]
    assert found["other_machine"]["processor"] == "other"
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "this: ours, 2 cores" in printed
    assert f"other ({other}): other, 2 cores" in printed
    assert "not in all runs: new" in printed


def test_other_work_is_named(python, monkeypatch, capsys):
    figures = {"speed": ("steps/s", 1.0)}
    monkeypatch.setattr(sys, "executable", python("ours", figures))
    other = python("other", figures, work="with other settings")
    assert main(["bench", "--quick", "--only", "start", "--against", other]) == 0
    assert "measured with different settings: speed" in capsys.readouterr().out


def test_a_group_without_figures_here_is_not_measured_there(python, monkeypatch):
    monkeypatch.setattr(sys, "executable", python("ours", {}))
    titles = []
    with pytest.raises(InputError, match="nothing was measured"):
        compare_with(python("other", {}), ["gpu"], [], titles.append)
    assert titles == ["gpu, this version"]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"help": "[--quick]"}, InputError, "no `bench --only` (allowed: the Python of"),
        ({"help_code": 2}, InputError, "reason (allowed: the Python of"),
        ({"output": "hello"}, TrainingError, "not the JSON of `skystack bench`"),
        ({"output": "\udcff"}, TrainingError, "not the JSON of `skystack bench`"),
        ({"code": 3}, TrainingError, "last words (exit code 3)"),
    ],
)
@pytest.mark.usefixtures("ours")
def test_another_python_that_cannot_measure_is_an_error(python, options, error, message):
    file = python("other", {}, **options)
    with pytest.raises(error) as raised:
        compare_with(file, ["start"], [], lambda _: None)
    assert message in str(raised.value)
    assert str(raised.value).startswith(f"--against {file}")


def test_a_program_that_does_not_answer_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(installations, "CHECK_S", 0.1)
    file = tmp_path / "sleeps"
    file.write_text("#!/bin/sh\nexec sleep 1000\n")
    file.chmod(0o755)
    with pytest.raises(InputError, match=r"no answer in 0 s \(allowed"):
        compare_with(str(file), ["start"], [], lambda _: None)


def test_the_groups_are_those_that_are_measured():
    assert groups_of(parts(Effort())) == GROUPS
    assert {part.group for part in parts(QUICK)} == set(GROUPS) - {"success", "sector"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--against", "/no/python"], "--against /no/python: No such file or directory (allowed:"),
        (["--against", ""], "--against : is empty (allowed:"),
        (["--against", "/"], "--against /: is a folder (allowed:"),
        (["--against", "python3", "--peers"], "--peers cannot be used with --against"),
        (
            ["--quick", "--only", "start", "success"],
            "--quick does not measure success (allowed:",
        ),
        (["--only", "strat"], "invalid choice: 'strat' (choose from "),
    ],
)
def test_bad_arguments_are_refused_in_one_line(capsys, arguments, message):
    assert main(["bench", *arguments]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert (out, err.count("\n")) == ("", 1)
