"""The comparison with another installed version, with programs that stand for the two Pythons."""

import json
import math
import sys

import pytest

from skystack.benchmarking.display import pairs_table
from skystack.benchmarking.paired import Pair, Side, compare_with
from skystack.cli import main
from skystack.errors import InputError

PROGRAM = """#!{interpreter}
import json, os, sys
assert sys.argv[1:5] == ["-P", "-m", "skystack", "bench"], sys.argv
arguments = sys.argv[5:]
if arguments == ["--help"]:
    print({help!r})
    sys.exit()
with open({log!r}, "a") as log:
    print({name!r}, *arguments, os.environ.get("PYTHONPATH", "-"), file=log)
count = sum(line.startswith({name!r}) for line in open({log!r}))
print({output!r} or json.dumps({{
    "machine": {{"name": {name!r}}},
    "figures": [
        {{"name": name, "unit": unit, "values": [factor * count, factor * count], "median": 1.0}}
        for name, (unit, factor) in {figures!r}.items()
    ],
}}))
sys.exit({code})
"""
INTERPRETER = sys.executable


@pytest.fixture
def python(tmp_path, monkeypatch):
    """Makes a program that stands for a Python whose skystack measures some figures.

    In its first run, each figure has its factor as its value, in the second one twice that.
    """
    monkeypatch.setenv("PYTHONPATH", "ours")

    def make(name, figures, usage="[--only GROUP]", output="", code=0):
        file = tmp_path / name
        program = PROGRAM.format(
            interpreter=INTERPRETER,
            name=name,
            figures=figures,
            help=usage,
            output=output,
            code=code,
            log=str(tmp_path / "log"),
        )
        file.write_text(program)
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
    ours, theirs = Side(((10.0, 30.0), (40.0, 20.0))), Side(((5.0, 5.0, 5.0), (10.0,)))
    rate, time = (Pair("any", unit, ours, theirs) for unit in ("steps/s", "s"))
    assert (rate.ratio, rate.ratios) == (25.0 / 5.0, (20.0 / 5.0, 30.0 / 10.0))
    assert (time.ratio, time.ratios) == (5.0 / 25.0, (5.0 / 20.0, 10.0 / 30.0))
    (line,) = pairs_table([rate]).rows
    assert line == ("any", "25.0", "5.00", "steps/s", "5.00", "3.00 to 4.00")


@pytest.mark.usefixtures("ours")
def test_both_are_measured_in_turn_and_the_other_without_our_packages(other, tmp_path):
    titles = []
    compared = compare_with(other, ["start", "simulator"], ["--quick"], titles.append)
    log = (tmp_path / "log").read_text().splitlines()
    assert [line.split()[0] for line in log] == ["ours", "other", "other", "ours"] * 2
    assert log[0] == "ours --json --quick --only start ours"
    assert log[5] == "other --json --quick --only simulator -"
    assert titles[:2] == ["start, this version", "start, the other version"]
    assert len(titles) == 8
    assert compared.other_machine == {"name": "other"}
    assert compared.unpaired == ["new", "new", "old", "old"]
    speed, start = compared.pairs[:2]
    assert (speed.name, speed.ratio, speed.ratios) == ("speed", 3.0, (3.0, 3.0))
    assert speed.ours.rounds == ((30.0, 30.0), (60.0, 60.0))
    assert (start.name, start.ratio) == ("start", 4.0)


def test_a_training_run_without_success_takes_forever(python, monkeypatch):
    monkeypatch.setattr(sys, "executable", python("ours", {"success": ("s", 5.0)}))
    figures = [{"name": "success", "unit": "s", "values": [None, 8.0, 9.0]}]
    output = json.dumps({"machine": {}, "figures": figures})
    (pair,) = compare_with(python("other", {}, output=output), ["start"], [], print).pairs
    assert pair.theirs.rounds == ((math.inf, 8.0, 9.0),) * 2
    assert pair.as_json["other_values"] == ((None, 8.0, 9.0),) * 2
    assert pair.ratios == (9.0 / 5.0, 9.0 / 10.0)


@pytest.mark.usefixtures("ours")
def test_the_command_prints_both_and_their_ratio(other, capsys):
    assert main(["bench", "--quick", "--only", "start", "--against", other, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    speed = found["pairs"][0]
    assert (speed["name"], speed["ratio"], speed["ratios"]) == ("speed", 3.0, [3.0, 3.0])
    assert speed["other_values"] == [[10.0, 10.0], [20.0, 20.0]]
    assert found["unpaired"] == ["new", "old"]
    assert found["other_machine"] == {"name": "other"}


@pytest.mark.parametrize(
    ("figures", "options", "message"),
    [
        ({}, {"usage": "[--quick]"}, "no `bench --only` (allowed: the Python of"),
        ({}, {"output": "hello"}, "not the JSON of `skystack bench`"),
        ({}, {"code": 3}, "exit code 3 while start was measured"),
    ],
)
@pytest.mark.usefixtures("ours")
def test_another_python_that_cannot_measure_is_refused(python, figures, options, message):
    file = python("other", figures, **options)
    with pytest.raises(InputError) as error:
        compare_with(file, ["start"], [], lambda _: None)
    assert message in str(error.value)
    assert str(error.value).startswith(f"--against {file}: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--against", "/no/python"], "--against /no/python: No such file or directory"),
        (["--against", "python3", "--peers"], "--peers cannot be used with --against"),
        (["--quick", "--only", "success"], "--quick measures nothing of success (allowed: start,"),
        (["--only", "strat"], "invalid choice: 'strat' (choose from "),
    ],
)
def test_bad_arguments_are_refused_in_one_line(capsys, arguments, message):
    assert main(["bench", *arguments]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert (out, err.count("\n")) == ("", 1)
