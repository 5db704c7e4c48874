"""The page as it is written: whole, small, closed; and what is refused before."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pytest

from skystack.cli import main
from skystack.errors import InputError
from skystack.reporting.replay.page import SCALE, page_data, write_replay
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
            for name, values, scale in (
                ("x", flown.position_nm[:, 0], SCALE["nm"]),
                ("y", flown.position_nm[:, 1], SCALE["nm"]),
                ("heading", flown.heading_deg, SCALE["deg"]),
                ("cleared_fl", flown.cleared_fl, SCALE["fl"]),
            ):
                steps = column[name] + [0] * (rows - len(column[name]))
                np.testing.assert_allclose(np.cumsum(steps) / scale, values, atol=0.5001 / scale)


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


def test_only_the_same_scenarios_are_shown_side_by_side(one_by_one, at_once, alone):
    first, other, lonely = map(read_replay, (one_by_one, at_once, alone))
    titles = [run["title"] for run in page_data((first, other))["runs"]]
    assert titles == ["one &amp; <b>one", "at once"]
    with pytest.raises(InputError, match="scenario 0 of alone begins otherwise"):
        page_data((first, lonely))
    moved = dataclasses.replace(
        other.scenarios[0].aircraft[0], position_nm=other.scenarios[0].aircraft[0].position_nm + 0.2
    )
    aircraft = (moved, other.scenarios[0].aircraft[1])
    elsewhere = dataclasses.replace(other.scenarios[0], aircraft=aircraft)
    with pytest.raises(InputError, match="begins otherwise"):
        page_data((first, dataclasses.replace(other, scenarios=(elsewhere,))))
    later = dataclasses.replace(other.scenarios[0], number=7)
    with pytest.raises(InputError, match="no scenario in common"):
        page_data((first, dataclasses.replace(other, scenarios=(later,))))
    sector = dataclasses.replace(other.sector, name="another")
    with pytest.raises(InputError, match="is of sector another"):
        page_data((first, dataclasses.replace(other, sector=sector)))


def test_runs_of_one_name_are_told_apart_by_their_place(evaluation, tmp_path):
    again = shutil.copytree(evaluation, tmp_path / evaluation.name)
    written = write_replay((evaluation, again), tmp_path / "page.html", scenarios=1)
    assert written["runs"] == [str(evaluation), str(again)]
