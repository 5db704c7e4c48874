"""The page as it is written: whole, small, closed; and what is refused before."""

import json
import re
import shutil

import numpy as np
import pytest

from skystack.cli import main
from skystack.reporting.replay.page import PARTS, page_data
from skystack.reporting.replay.recording import read_replay

from .conftest import SCENARIOS


def run(capsys, *words):
    code = main(["replay", *map(str, words)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_differences_add_up_to_what_was_flown(evaluation):
    replay = read_replay(evaluation, scenarios=3)
    data = page_data((replay,))
    for packed, scenario in zip(data["runs"][0]["scenarios"], replay.scenarios, strict=True):
        for column, flown in zip(packed["aircraft"], scenario.aircraft, strict=True):
            rows = len(flown.status)
            assert column["rows"] == rows
            for name, values, off_by in (
                ("x", flown.position_nm[:, 0], 0.5001 / PARTS["nm"]),
                ("y", flown.position_nm[:, 1], 0.5001 / PARTS["nm"]),
                ("heading", flown.heading_deg, 0.5001 / PARTS["deg"]),
                ("speed_kt", flown.ground_speed_kt, 0.5001 / PARTS["kt"]),
                ("fl", flown.fl, 1e-9),
                ("cleared_fl", flown.cleared_fl, 1e-9),
                ("climb_ft_min", flown.vertical_speed_ft_min, 1e-9),
            ):
                unit = {"x": "nm", "y": "nm", "heading": "deg", "climb_ft_min": "ft_min"}
                parts = PARTS[unit.get(name, name.split("_")[-1])]
                changes = column[name] + [0] * (rows - len(column[name]))
                found = np.cumsum(np.cumsum(changes)) / parts
                np.testing.assert_allclose(found, values, atol=off_by)


def test_the_command_writes_one_small_closed_file(capsys, evaluation, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, evaluation, "--json")
    written = json.loads(out)
    assert (code, err.count("\n")) == (0, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["replay.html"]
    text = (tmp_path / "replay.html").read_text()
    assert written == {
        "output": "replay.html",
        "bytes": len(text.encode()),
        "runs": ["avoidance, stacked"],
        "scenarios": SCENARIOS,
    }
    assert written["bytes"] < 3e6 * SCENARIOS / 100
    # Nothing is fetched: the only address is the name of a kind of markup.
    assert set(re.findall(r"https?://[^\s\"']+", text)) == {"http://www.w3.org/2000/svg"}
    assert re.findall(r"(?:src|href)=\"(?!#|data:)[^\"]*\"", text) == []


def test_as_many_scenarios_as_asked_for(capsys, evaluation, tmp_path):
    code, out, _ = run(capsys, evaluation, "--scenarios", 2, "-o", tmp_path / "two.html", "--json")
    assert (code, json.loads(out)["scenarios"]) == (0, 2)


@pytest.mark.parametrize("table", ["episodes", "aircraft", "trajectories", "clearances"])
def test_no_page_of_a_folder_that_is_not_whole(capsys, evaluation, tmp_path, table):
    copied = shutil.copytree(evaluation, tmp_path / "copied")
    (copied / f"{table}.parquet").unlink()
    code, out, err = run(capsys, copied, "-o", tmp_path / "page.html")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{table}.parquet" in err
    assert not (tmp_path / "page.html").exists()


def test_the_folder_of_the_page_must_exist(capsys, evaluation, tmp_path):
    code, _, err = run(capsys, evaluation, "-o", tmp_path / "nowhere" / "page.html")
    assert (code, err.count("\n")) == (2, 1)
    assert "does not exist" in err


@pytest.mark.parametrize("name", ["still.png", "still.svg", "film.gif"])
def test_pictures_of_a_part_of_a_scenario(capsys, evaluation, tmp_path, name):
    target = tmp_path / name
    part = ["--scenario", 2, "--from", 30, "--to", 60]
    code, out, err = run(capsys, evaluation, evaluation, "-o", target, *part, "--json")
    assert code == 0
    found = json.loads(out)
    assert (found["from_s"], found["to_s"], found["bytes"]) == (30, 60, target.stat().st_size)
    assert str(target) in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "page.pdf"], "replay: -o page.pdf (allowed: .html, .png, .svg, .gif)"),
        (["-o", "page.html", "--scenario", 2], "replay: --scenario is for pictures"),
        (["--from", 6], "replay: --from is for pictures (.png, .svg, .gif)"),
        (["-o", "still.png", "--scenario", 99], "has no scenario 99 (found: 0 to 19)"),
        (["-o", "still.png", "--to", 60000], "--from 0 --to 60000 (allowed: times from 0 to"),
        (["-o", "nowhere/still.png"], "the folder nowhere does not exist"),
    ],
)
def test_what_cannot_be_drawn(capsys, evaluation, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, evaluation, *words)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert list(tmp_path.iterdir()) == []
