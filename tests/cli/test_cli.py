"""The command line, as a new user would use and misuse it."""

import json
import math
import os
import shlex
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import skystack
from skystack.airspace.projection import WGS84
from skystack.benchmarking import peers
from skystack.benchmarking import run as benchmarking
from skystack.benchmarking.figures import Figure
from skystack.benchmarking.peers import Peer
from skystack.cli import main
from skystack.cli.output import program
from skystack.evaluation.stored import stored_scenario
from skystack.io.locks import locked_folder
from skystack.reproduction import cluster
from tests.reporting.conftest import write_run
from tests.waiting import TIMEOUT_S, wait_until

EXAMPLES = Path(__file__).parents[2] / "examples"

SMALL = [
    "--set", "ppo.total_steps=512", "--set", "ppo.environments=8", "--set", "ppo.steps=32",
    "--set", "ppo.minibatch=64", "--set", "ppo.epochs=1",
]  # fmt: skip


def run(capsys, *arguments):
    code = main(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_list_names_everything(capsys):
    code, out, _ = run(capsys, "list", "--json")
    found = json.loads(out)
    assert code == 0
    assert {"lateral", "lateral-undamped", "lateral-large", "lateral-best"} <= set(
        found["experiments"]
    )
    assert set(found["policies"]) <= set(found["experiments"])
    assert found["sectors"] == ["x-plus", "crossing", "highland", "merge"]
    code, out, _ = run(capsys, "list")
    assert "lateral-undamped" in out


@pytest.mark.slow
def test_evaluates_a_shipped_policy(capsys, tmp_path):
    code, out, _ = run(
        capsys, "evaluate", "lateral", "--episodes", "5", "--json", "--out", str(tmp_path / "e")
    )
    result = json.loads(out)
    assert code == 0
    assert set(result) == {"rows", "rows_by_seed", "train", "wall_s"}
    row = result["rows"][0]
    assert (row["experiment"], row["episodes"], row["stacking"], row["greedy"]) == (
        "lateral",
        5,
        True,
        True,
    )
    assert len(list((tmp_path / "e").glob("*/episodes.parquet"))) == 1
    code, out, _ = run(
        capsys, "evaluate", "lateral", "--episodes", "5", "--no-stacking", "--sample"
    )
    assert code == 0
    assert "7.2" not in out
    assert "14.5" in out


@pytest.mark.slow
def test_trains_then_evaluates_the_run(capsys, tmp_path):
    out_folder = str(tmp_path / "run")
    code, out, err = run(capsys, "train", "lateral-large", "--json", "--out", out_folder, *SMALL)
    assert code == 0
    assert json.loads(out)["train"][0]["steps"] == 512
    assert "steps/s" in err
    code, out, _ = run(capsys, "evaluate", out_folder, "--episodes", "3", "--json")
    assert json.loads(out)["rows"][0]["experiment"] == "lateral-large"


@pytest.mark.slow
def test_own_sector_works_in_every_command(capsys, tmp_path):
    """Train and evaluate in it, read it from the tables, simulate in it; a typo is an error."""
    folder = EXAMPLES / "own-sector"
    out = tmp_path / "run"
    code, _, _ = run(capsys, "train", str(folder / "valley.toml"), "--out", str(out), *SMALL)
    assert code == 0
    options = ["--episodes", "3", "--json"]
    code, _, _ = run(capsys, "evaluate", str(out), *options, "--out", str(tmp_path / "e"))
    assert code == 0
    (tables,) = (tmp_path / "e").iterdir()
    scenario = stored_scenario(tables, 1)
    assert scenario.sector.name == "valley"
    assert {one.route[0] for one in scenario.aircraft} <= {"GATEN", "GATEW", "GATEO"}
    code, _, _ = run(capsys, "simulate", str(folder / "meeting.json"), "--json")
    assert code == 0
    code, _, err = run(capsys, "evaluate", str(out), *options, "--sector", "merg")
    assert (code, err.count("\n")) == (2, 1)


@pytest.mark.slow
def test_trains_in_a_shipped_sector(capsys, tmp_path):
    """With a small budget; then evaluate in another sector, where the observations are the same."""
    out = str(tmp_path / "run")
    change = ["--set", "task.sector=highland"]
    assert run(capsys, "train", "lateral-best", "--out", out, *SMALL, *change)[0] == 0
    options = ["--episodes", "3", "--json", "--out", str(tmp_path / "e")]
    code, printed, _ = run(capsys, "evaluate", out, *options, "--sector", "x-plus")
    assert code == 0
    assert json.loads(printed)["rows"][0]["episodes"] == 3
    (tables,) = (tmp_path / "e").iterdir()
    assert stored_scenario(tables, 0).sector.name == "x-plus"


@pytest.mark.slow
def test_writes_event_files_also_of_a_finished_training(capsys, tmp_path):
    pytest.importorskip("tensorboardX")
    events = tmp_path / "run" / "tensorboard"
    command = ["train", "lateral-large", "--out", str(tmp_path / "run"), "--tensorboard", *SMALL]
    for options in ([], ["--resume"]):
        code, _, err = run(capsys, *command, *options)
        assert code == 0, err
        (file,) = events.iterdir()
        assert file.read_bytes().count(b"value_loss") == 2
        file.unlink()


@pytest.mark.slow
def test_report_rewrites_the_report_of_a_run(capsys, tmp_path):
    folder = write_run(tmp_path / "run", rows=[("lateral", True)], seeds=(0,), scenarios=2)
    results = json.loads((folder / "results.json").read_text())
    code, out, err = run(capsys, "report", str(folder), "-o", "page.html")
    assert (code, out) == (2, "")
    assert "-o is for comparisons" in err
    assert not (folder / "figures").exists()
    code, out, err = run(capsys, "report", str(folder), "--json")
    assert code == 0, err
    assert json.loads(out) == {
        key: results[key] for key in ("rows", "rows_by_seed", "train", "wall_s")
    }
    assert "damped and stacked" in (folder / "report.html").read_text()
    assert (folder / "figures" / "loop.png").exists()


@pytest.mark.slow
def test_report_of_one_training_is_a_comparison(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(capsys, "train", "lateral-large", "--out", "run", "--seed", "4", *SMALL)[0] == 0
    code, out, err = run(capsys, "report", "run")
    assert (code, err) == (0, "comparison: comparison.html\n")
    assert out.split("\n")[2].split()[:4] == ["run", "lateral-large", "4", "512"]
    assert "Learning curves of run" in (tmp_path / "comparison.html").read_text()


@pytest.mark.slow
def test_train_prints_notices_and_never_overwrites(capsys, tmp_path):
    """The notices are about a phase that is left out and a missing checkpoint; policies and
    unfinished runs are kept."""
    out = str(tmp_path / "run")
    code, _, err = run(capsys, "train", "lateral-best", "--out", out, "--resume", *SMALL)
    assert code == 0
    lines = err.splitlines()
    assert lines[0].startswith("pretraining.steps (800,000) covers all of ppo.total_steps (512)")
    assert lines[1] == f"{out} has no checkpoint: training starts from the beginning"
    assert lines[2] == "compiling ..."
    before = (tmp_path / "run" / "policy.safetensors").read_bytes()
    code, _, err = run(capsys, "train", "lateral-best", "--out", out, "--seed", "1", *SMALL)
    assert (code, err.count("\n")) == (2, 1)
    assert "already contains a trained policy" in err
    assert (tmp_path / "run" / "policy.safetensors").read_bytes() == before
    (tmp_path / "run" / "policy.json").unlink()
    code, _, err = run(capsys, "evaluate", out)
    assert (code, err) == (
        2,
        f"skystack: {out}: training is not finished (resume with train --resume)\n",
    )
    code, _, err = run(capsys, "train", "lateral-best", "--out", out, *SMALL)
    assert (code, err.count("\n")) == (2, 1)
    assert "contains an unfinished training run (allowed: --resume" in err


def test_reproduce_rejects_a_locked_folder(capsys, tmp_path):
    with locked_folder(tmp_path):
        code, out, err = run(capsys, "reproduce", "lateral", "--quick", "--out", str(tmp_path))
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"skystack: {tmp_path}: is in use by another process")
    assert [path.name for path in tmp_path.iterdir()] == [".lock"]


def test_describes_and_draws_a_sector(capsys, tmp_path):
    target = tmp_path / "map.png"
    file = str(EXAMPLES / "own-sector" / "valley.json")
    code, out, err = run(capsys, "sector", file, "-o", str(target))
    assert code == 0
    assert "valley: FL240 to FL400, 4 routes from 3 first fixes (GATEN, GATEO, GATEW)" in out
    assert str(target) in err
    assert target.read_bytes().startswith(b"\x89PNG")
    code, out, _ = run(capsys, "sector", "x-plus", "--json")
    routes = {each["route"]: each for each in json.loads(out)["routes"]}
    # Straight through the centre: 30 + 5 NM to it and 60 + 5 NM beyond, at 60 NM per degree.
    straight = routes["HERON CRANE EGL MACAW QUAIL SWIFT"]
    assert straight["length_nm"] == pytest.approx(100.0, rel=0.006)
    assert max(map(abs, straight["turns_deg"])) < 0.01
    for wrong in (["nosuch"], ["merge", "-o", str(tmp_path / "map.gif")]):
        code, _, err = run(capsys, "sector", *wrong)
        assert (code, err.count("\n")) == (2, 1)


@pytest.mark.slow
def test_routes_longer_than_a_scenario_need_more_cycles(capsys, tmp_path):
    """The exit is 270 NM away (347 cycles at 466 kt); aircraft may start up to 4 NM closer."""
    file = tmp_path / "long.json"
    fixes = {"S": (44.75, 8.0), "N": (49.25, 8.0), "NO": (49.35, 8.0), "SE": (44.85, 8.0)}
    long = {
        "name": "long",
        "levels_fl": [200.0, 400.0],
        "separation_nm": 3,
        "area": {
            "type": "MultiPolygon",
            "coordinates": [[[[7.5, 44.85, 0], [8.5, 44.85, 0], [8.5, 49.25, 0], [7.5, 49.25, 0]]]],
        },
        "fixes": {name: {"lat": lat, "lon": lon} for name, (lat, lon) in fixes.items()},
        "routes": [["S", "N", "NO"], ["NO", "SE", "S"]],
    }
    file.write_text(json.dumps(long))
    needed, longest = (
        math.ceil((WGS84.inv(8.0, start, 8.0, end)[2] / 1852.0 - 4.0) / 465.94 * 600.0)
        for start, end in ((44.75, 49.25), (49.35, 44.85))
    )
    span = f"{needed} to {longest}" if needed < longest else f"{needed}"
    notice = f"2 of 2 routes take more than 300 cycles: {span} at 466 kt (see --cycles)"
    code, out, _ = run(capsys, "sector", str(file))
    assert (code, notice in out) == (0, True)
    assert "separation: 3 NM or 1,000 ft" in out
    code, out, _ = run(capsys, "sector", str(file), "--cycles", str(longest))
    assert (code, "routes take more" in out) == (0, False)
    message = f"takes {needed} at 466 kt (allowed: {needed} to 10000"
    evaluation = ("evaluate", "lateral-best", "--sector", str(file), "--episodes", "2", "--json")
    training = ("train", "lateral", "--set", f"task.sector={file}", "--out", str(tmp_path / "t"))
    for command in (evaluation, training):
        code, out, err = run(capsys, *command)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert message in err
    assert not (tmp_path / "t").exists()
    code, out, err = run(capsys, *evaluation, "--cycles", str(needed + 30))
    assert (code, "take more" in err) == (0, False)
    assert json.loads(out)["rows"][0]["episodes"] == 2
    small = [*SMALL, "--cycles", str(needed), "--json"]
    assert run(capsys, *training, *small)[0] == 0
    config = tomllib.loads((tmp_path / "t" / "config.toml").read_text())
    assert config["task"]["cycles"] == needed
    assert config["task"]["sector"]["separation_nm"] == 3.0
    for cycles in ("0", "10001", "x"):
        code, _, err = run(capsys, "sector", str(file), "--cycles", cycles)
        assert (code, err.count("\n")) == (2, 1)


@pytest.mark.slow
def test_simulates_the_examples(capsys, tmp_path):
    for example in sorted(EXAMPLES.glob("*.json")) + sorted(EXAMPLES.glob("*/meeting.json")):
        target = tmp_path / "trajectories.parquet"
        code, out, _ = run(capsys, "simulate", str(example), "-o", str(target), "--json")
        assert code == 0
        assert json.loads(out)["rows"] > 0
        assert target.exists()
    code, out, _ = run(capsys, "simulate", str(EXAMPLES / "reference.json"))
    assert "AC1" in out


@pytest.mark.slow
@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize(
    ("platform", "module", "types"),
    [("bluebird", "bluebird_dt", "B753"), ("bluesky", "bluesky", "B752")],
)
def test_simulates_and_evaluates_on_other_platforms(capsys, tmp_path, platform, module, types):
    pytest.importorskip(module)
    target = tmp_path / "trajectories.parquet"
    arguments = ["simulate", str(EXAMPLES / "climb.json"), "--platform", platform]
    code, out, err = run(capsys, *arguments, "-o", str(target), "--json")
    result = json.loads(out)
    assert (code, result["platform"], result["types"]) == (0, platform, {"AC1": types})
    assert result["clearances"] == [{"cycle": 2, "callsign": "AC1", "text": "AC1 climb FL300"}]
    assert result["final"][0]["fl"] == pytest.approx(300.0, abs=1e-6)
    assert ("flown as B752" in err) == (platform == "bluesky")
    arguments = ["evaluate", "lateral-best", "--platform", platform, "--episodes", "2"]
    code, out, err = run(capsys, *arguments, "--json")
    row = json.loads(out)["rows"][0]
    assert (code, row["platform"], row["episodes"]) == (0, platform, 2)
    assert ("flown as B752" in err) == (platform == "bluesky")


def test_names_the_extra_of_a_missing_platform(capsys, monkeypatch):
    from skystack.platforms import registry

    monkeypatch.setattr(registry, "_installed", lambda name: False)
    code, _, err = run(capsys, "evaluate", "lateral", "--platform", "bluesky")
    assert code == 2
    assert "the extra [bluesky]" in err
    assert err.count("\n") == 1


def test_names_the_extra_of_a_missing_engine(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    code, _, err = run(capsys, "reproduce", "--engine", "ray", "--out", str(tmp_path / "out"))
    assert code == 2
    assert err.splitlines()[-1].endswith("extra [ray]; in a checkout: pip install -e '.[ray]')")
    assert list(tmp_path.iterdir()) == []


def test_unreachable_cluster_leaves_no_files(capsys, tmp_path, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, "reproduce", "--engine", "ray", "--ray-address", "127.0.0.1:9")
    assert (code, err.splitlines()[-1].startswith("skystack: cannot join a Ray cluster")) == (
        2,
        True,
    )
    assert list(tmp_path.iterdir()) == []


def test_names_the_extra_of_missing_tensorboard(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    out = tmp_path / "out"
    code, _, err = run(capsys, "train", "lateral", "--tensorboard", "--out", str(out))
    assert code == 2
    assert err.endswith("in a checkout: pip install -e '.[tensorboard]')\n")
    assert not out.exists()


def test_refused_training_leaves_no_event_files(capsys, tmp_path):
    shipped = Path(skystack.__file__).parent / "policies" / "lateral" / "policy.json"
    (tmp_path / "policy.json").write_bytes(shipped.read_bytes())
    code, _, err = run(capsys, "train", "lateral", "--tensorboard", "--out", str(tmp_path))
    assert (code, err.count("\n")) == (2, 1)
    assert "already contains a trained policy" in err
    assert not (tmp_path / "tensorboard").exists()


@pytest.mark.slow
def test_names_scenarios_that_a_platform_did_not_finish(capsys, monkeypatch):
    from skystack.evaluation import evaluate

    def fails(task, controller, conditions, failed, on_scenario):
        failed |= {1: "took more than 9 s", 2: "Bird has lost AC1"}
        yield from evaluate.prepare(task, controller().decide, True)(controller().weights, 0, 2)

    monkeypatch.setattr(evaluate, "_fly_on_platform", fails)
    monkeypatch.setattr(evaluate, "check_platform", lambda name: None)
    arguments = ["evaluate", "lateral-best", "--platform", "bluebird", "--episodes", "2", "--json"]
    code, out, err = run(capsys, *arguments)
    assert code == 1
    assert json.loads(out)["failed"] == {"1": "took more than 9 s", "2": "Bird has lost AC1"}
    assert err.splitlines()[-2:] == [
        "skystack: bluebird: scenario 1 took more than 9 s",
        "skystack: bluebird: scenario 2 Bird has lost AC1",
    ]


def test_names_the_scenario_that_a_platform_failed_on(capsys, monkeypatch):
    pytest.importorskip("pebble")
    from skystack.evaluation import simulate
    from skystack.platforms.processes import ItemResult

    monkeypatch.setattr(simulate, "check_platform", lambda name: None)
    monkeypatch.setattr(
        simulate, "in_processes", lambda *_: [ItemResult(None, "took more than 5 s")]
    )
    path = EXAMPLES / "climb.json"
    code, _, err = run(capsys, "simulate", str(path), "--platform", "bluebird")
    assert (code, err) == (1, f"skystack: {path}: bluebird: took more than 5 s\n")


def test_exports_a_scenario(capsys, tmp_path):
    target = tmp_path / "climb.scn"
    code, out, _ = run(capsys, "export", str(EXAMPLES / "climb.json"), "-o", str(target), "--json")
    assert (code, json.loads(out)["output"]) == (0, str(target))
    assert "00:00:12.00>ALT AC1 FL300" in target.read_text().splitlines()


@pytest.mark.parametrize("kind", ["onnx", "numpy"])
def test_exports_a_policy(capsys, tmp_path, kind):
    if kind == "onnx":
        pytest.importorskip("onnx")
    target = tmp_path / "policy"
    arguments = ["export", "lateral", "--format", kind, "-o", str(target), "--json"]
    code, out, err = run(capsys, *arguments)
    assert (code, json.loads(out)["source"], err) == (0, "lateral", f"written: {target}\n")
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.slow
def test_reproduces_end_to_end(capsys, tmp_path, monkeypatch):
    """Small trainings of three of the experiments, in real worker processes; all output files."""
    from skystack.reproduction import plan

    names = ("lateral-undamped", "lateral", "lateral-best")
    monkeypatch.setattr(plan, "families_of_experiments", lambda: {"lateral": names})
    monkeypatch.setattr(plan, "QUICK_STEPS", 8192)
    out_folder = tmp_path / "run"
    command = ("reproduce", "lateral", "--quick", "--episodes", "12", "--json")
    command = (*command, "--out", str(out_folder))
    code, out, err = run(capsys, *command)
    assert code == 0, err
    assert "reused" not in err
    result = json.loads(out)
    rows = {(row["experiment"], row["stacking"]) for row in result["rows"]}
    assert rows == {(name, stacking) for name in names for stacking in (False, True)} | {
        ("do-nothing-lateral", False)
    }
    assert {training["experiment"] for training in result["train"]} == set(names)
    page = (out_folder / "report.html").read_text()
    assert "online action-stacking" in page.lower()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert len(list((out_folder / "figures").glob("*.svg"))) > 5
    assert json.loads((out_folder / "results.json").read_text())["quick"] is True
    monkeypatch.setattr("skystack.reporting.report.write_report", lambda run: run / "report.html")
    code, again, err = run(capsys, *command)  # drawing the report again would be slow
    assert code == 0, err
    assert "reused 10 cached results of an earlier run" in err  # 3 trainings, 7 evaluations
    same = ("rows", "rows_by_seed", "comparisons", "train")
    assert [json.loads(again)[key] for key in same] == [result[key] for key in same]
    one = str(out_folder / "train" / "lateral-s0")
    page = tmp_path / "page.html"
    code, out, err = run(capsys, "report", str(out_folder), one, "--json", "-o", str(page))
    assert code == 0, err
    compared = json.loads(out)
    assert len(compared["train"]) == len(names) + 1
    assert {each["run"] for each in compared["rows"]} == {"run"}
    assert "<h1>Comparison of runs</h1>" in page.read_text()


def test_resume_command_can_be_pasted_into_a_shell(capsys, tmp_path, monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("skystack.learning.run.train_experiment", interrupted)
    out, change = str(tmp_path / "a b"), 'description=it\'s "x" $HOME'
    code, _, err = run(capsys, "train", "vertical", "--out", out, "--set", change)
    assert code == 130
    _, _, command = err.splitlines()[-1].partition("to resume: ")
    arguments = ["train", "vertical", "--seed", "0", "--out", out, "--resume", "--set", change]
    assert shlex.split(command) == [*shlex.split(program()), *arguments]


MISTAKES = [
    (["trian", "lateral"], "did you mean 'train'"),
    (["train", "laterla"], "did you mean 'lateral'"),
    (["train", "lateral", "--set", "ppo.learning_rat=1"], "did you mean 'ppo.learning_rate'"),
    (["train", "lateral", "--set", "ppo.total_steps=0"], "ppo.total_steps"),
    (["train", "lateral", "--seed", "-1"], "--seed"),
    (["train", "lateral", "--checkpoint-every", "-1"], "whole numbers from 0"),
    (["train", "lateral", "--seed", "99999999999"], "whole numbers from 0 to 2147483647"),
    (["train", "lateral", "--outt", "x"], "did you mean --out"),
    (["train"], "EXPERIMENT"),
    (["reproduce", "latreal"], "did you mean 'lateral'"),
    (["reproduce", "--seeds", "0"], "--seeds"),
    (["reproduce", "--episodes", "-3"], "--episodes"),
    (["evaluate", "lateral", "--episodes", "0"], "--episodes"),
    (["evaluate", "lateral", "--episodes", "many"], "whole numbers"),
    (["evaluate", "lateral", "--greedy", "--sample"], "not allowed with"),
    (["evaluate", "nowhere"], "unknown policy 'nowhere'"),
    (["simulate", "nowhere.json"], "nowhere.json"),
    (
        ["simulate", str(EXAMPLES / "climb.json"), "--platform", "bluebrid"],
        "did you mean 'bluebird'",
    ),
    (["evaluate", "lateral", "--platform", "x"], "allowed: bluebird, bluesky, skystack"),
    (["evaluate", "lateral", "--time-limit", "0"], "--time-limit"),
    (["reproduce", "--platform", "bleusky"], "did you mean 'bluesky'"),
    (["export", str(EXAMPLES / "climb.json")], "-o"),
    (["export", "nowhere", "-o", "x.scn"], "nowhere"),
    (["export", str(EXAMPLES / "climb.json"), "-o", "x.scn", "--format", "xml"], "scn"),
    (["export", "lateral", "-o", "x.scn"], "--format scn is for flown scenarios"),
    (["export", "laterla", "-o", "x", "--format", "numpy"], "did you mean 'lateral'"),
    (["export", "lateral", "-o", "x", "--format", "onnx", "--scenario", "1"], "--scenario is 1"),
    (["report"], "RUN"),
    (["report", "nowhere"], "nowhere does not exist"),
    (["report", "nowhere", "neither", "-o", "page.html"], "nowhere does not exist"),
    (["replay", "x" * 300], "File name too long"),
    (["evaluate", "x" * 300], "unknown policy"),
    (["reproduce", "lateral", "--engine", "rya"], "invalid choice: 'rya'"),
    (["reproduce", "lateral", "--ray-address", "127.0.0.1:9"], "--ray-address is for --engine ray"),
]


def mistake_id(value):
    return (value if isinstance(value, str) else " ".join(value))[:40]


@pytest.mark.parametrize(("arguments", "message"), MISTAKES, ids=mistake_id)
def test_mistakes_give_one_line_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err
    assert list(tmp_path.iterdir()) == []


SCENARIO = json.loads((EXAMPLES / "reference.json").read_text())


def broken(**changes):
    scenario = json.loads(json.dumps(SCENARIO))
    for path, value in changes.items():
        *parents, last = path.split("__")
        inner = scenario
        for step in parents:
            inner = inner[int(step)] if step.isdigit() else inner[step]
        inner[last] = value
    return scenario


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (broken(aircraft__0__route=["HERON", "CRAN"]), "did you mean 'CRANE'"),
        (broken(aircraft__1__callsign="AC1"), "AC1"),
        (broken(aircraft__0__fl=500), "500"),
        (broken(aircraft__0__lat=float("inf")), "Infinity"),
        (broken(clearances__0__fl=450), "450"),
    ],
)
def test_broken_scenarios_leave_no_output(capsys, tmp_path, scenario, message):
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(scenario))
    code, out, err = run(capsys, "simulate", str(path), "-o", str(tmp_path / "out.parquet"))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err
    assert list(tmp_path.iterdir()) == [path]


def test_unwritable_folders_are_errors(capsys, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    for arguments in (
        ["train", "lateral", "--out", str(file / "run"), *SMALL],
        ["reproduce", "--quick", "--out", str(file / "run")],
        ["evaluate", "lateral", "--episodes", "1", "--out", str(file / "e")],
        ["simulate", str(EXAMPLES / "reference.json"), "-o", str(tmp_path / "no" / "out.parquet")],
    ):
        code, _, err = run(capsys, *arguments)
        assert code == 2, arguments
        assert len(err.strip().splitlines()) == 1, err
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.slow
def test_interrupted_evaluation_on_bluebird_leaves_nothing(tmp_path):
    pytest.importorskip("bluebird_dt")
    out, scratch = tmp_path / "out", tmp_path / "scratch"
    scratch.mkdir()
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from skystack.cli import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", program, "evaluate", "lateral", "--platform", "bluebird"]
    process = subprocess.Popen(
        [*command, "--out", str(out)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"TMPDIR": str(scratch)},
    )
    wait_until(lambda: list(scratch.glob("skystack-*/*")))
    os.killpg(process.pid, signal.SIGINT)  # like a terminal, also to the workers
    _, err = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, err.splitlines()[-1]) == (130, "skystack: interrupted")
    assert "Traceback" not in err
    assert not out.exists()
    assert list(scratch.glob("skystack-*")) == []
    wait_until(lambda: not group_exists(process.pid))


def group_exists(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_interrupted_training_ends_cleanly_and_can_be_resumed(tmp_path):
    out_folder = tmp_path / "run"
    # Background processes ignore SIGINT, so set the handler that Python has in a terminal.
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from skystack.cli import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", program, "train", "lateral", "--out", str(out_folder)]
    small = ["--set", "ppo.environments=8", "--set", "ppo.steps=32", "--set", "ppo.minibatch=64"]
    process = subprocess.Popen([*command, *small], stderr=subprocess.PIPE, text=True)
    metrics = out_folder / "metrics.jsonl"
    wait_until(lambda: metrics.exists() and metrics.read_text())
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "--resume" in err.splitlines()[-1]
    assert (out_folder / "checkpoint" / "learner.safetensors").exists()
    assert not (out_folder / "policy.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--peers"]])
def test_bench_measures_skystack_and_names_missing_peers(capsys, monkeypatch, options):
    fast = Figure("fast", "steps/s", (3.0, 5.0, 4.0), "sitting")
    if options:
        monkeypatch.setattr(benchmarking, "measure_skystack", lambda *_: [fast])
        monkeypatch.setattr(
            peers, "PEERS", (*AVAILABLE_PEERS, Peer("absent", "fast", missing_peer, ""))
        )
    assert main(["bench", "--quick", "--json", *options]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["machine"]["cores"] >= 1
    figures = {figure["name"]: figure for figure in found["figures"]}
    for figure in figures.values():
        assert 0.0 < figure["least"] <= figure["median"] <= figure["greatest"]
    if not options:
        assert found["ratios"] == found["not_measured"] == {}
        units = {(name, figure["unit"]) for name, figure in figures.items()}
        assert {("training, lateral", "steps/s"), ("first update, cold", "s")} <= units
        assert {"first update, warm", "simulator, 2 aircraft"} <= figures.keys()
    else:
        assert found["not_measured"] == {"absent": "No module named 'absent'"}
        assert found["ratios"] == {"half as fast": 2.0}


def missing_peer(repetitions):
    raise ModuleNotFoundError("No module named 'absent'")


def two_per_second(repetitions):
    return (2.0,) * repetitions


AVAILABLE_PEERS = (Peer("half as fast", "fast", two_per_second, ""),)


def test_help_does_not_import_jax():
    program = """
import sys
from skystack.cli import main
try:
    main(["--help"])
except SystemExit:
    print("jax" in sys.modules)
"""
    command = [sys.executable, "-c", program]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "reproduce" in found.stdout
    assert found.stdout.split()[-1] == "False"
