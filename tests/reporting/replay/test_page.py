"""The written page is complete, small and self-contained; invalid requests are rejected."""

import json
import re
import shutil

import numpy as np
import pytest

from skystack.cli import main
from skystack.reporting.replay.page import PARTS, page_data
from skystack.reporting.replay.recording import read_replay

from .conftest import SCENARIOS, WGS84


def run(capsys, *words):
    code = main(["replay", *map(str, words)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_stored_differences_add_up_to_the_flight(evaluation):
    replay = read_replay(evaluation, scenarios=3)
    data = page_data((replay,))
    for packed, scenario in zip(data["runs"][0]["scenarios"], replay.scenarios, strict=True):
        for column, flown in zip(packed["aircraft"], scenario.aircraft, strict=True):
            rows = len(flown.status)
            assert column["rows"] == rows
            for name, values, tolerance in (
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
                np.testing.assert_allclose(found, values, atol=tolerance)


def test_command_writes_one_small_self_contained_file(capsys, evaluation, tmp_path, monkeypatch):
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
    # Nothing is loaded: the only address is the SVG namespace.
    assert set(re.findall(r"https?://[^\s\"']+", text)) == {"http://www.w3.org/2000/svg"}
    assert re.findall(r"(?:src|href)=\"(?!#|data:)[^\"]*\"", text) == []


def test_page_has_the_requested_number_of_scenarios(capsys, evaluation, tmp_path):
    code, out, _ = run(capsys, evaluation, "--scenarios", 2, "-o", tmp_path / "two.html", "--json")
    assert (code, json.loads(out)["scenarios"]) == (0, 2)


@pytest.mark.parametrize("table", ["episodes", "aircraft", "trajectories", "clearances"])
def test_writes_no_page_if_a_table_is_missing(capsys, evaluation, tmp_path, table):
    copied = shutil.copytree(evaluation, tmp_path / "copied")
    (copied / f"{table}.parquet").unlink()
    code, out, err = run(capsys, copied, "-o", tmp_path / "page.html")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{table}.parquet" in err
    assert not (tmp_path / "page.html").exists()


def test_output_folder_must_exist(capsys, evaluation, tmp_path):
    code, _, err = run(capsys, evaluation, "-o", tmp_path / "nowhere" / "page.html")
    assert (code, err.count("\n")) == (2, 1)
    assert "does not exist" in err


@pytest.mark.parametrize("name", ["still.png", "still.svg", "film.gif"])
def test_writes_pictures_of_part_of_a_scenario(capsys, evaluation, tmp_path, name):
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
        (["-o", "page.pdf"], "replay: -o page.pdf (allowed: .html, .png, .svg, .gif, .mp4)"),
        (["-o", "page.html", "--scenario", 2], "replay: --scenario is for pictures"),
        (["--from", 6], "replay: --from is for pictures and films (.png, .svg, .gif, .mp4)"),
        (["-o", "still.png", "--scenario", 99], "has no scenario 99 (found: 0 to 19)"),
        (["-o", "still.png", "--to", 60000], "--from 0 --to 60000 (allowed: times from 0 to"),
        (["-o", "nowhere/still.png"], "the folder nowhere does not exist"),
        (["-o", "still.png", "--scenarios", 3], "replay: --scenarios is for pages (.html)"),
    ],
)
def test_rejects_invalid_options(capsys, evaluation, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, evaluation, *words)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert list(tmp_path.iterdir()) == []


def test_no_second_after_the_end_is_drawn(capsys, alone, tmp_path):
    """The flight ends after ten cycles of six seconds."""
    code, _, err = run(capsys, alone, "-o", tmp_path / "still.png", "--from", 61)
    assert (code, err.count("\n")) == (2, 1)
    assert "--from 61 --to 60 (allowed: times from 0 to 60 s" in err


def test_airways_follow_geodesics(far_north):
    """Points on the geodesics of curved legs are within 0.06 NM of the drawn lines."""
    replay = read_replay(far_north)
    sector, drawn = replay.sector, page_data((replay,))["sector"]
    curved = {
        tuple(json.loads(ends)): np.array(points) for ends, points in drawn["bent_legs"].items()
    }
    assert set(curved) == {("WESTE", "EASTE"), ("EASTE", "WESTE")}
    for (start, end), points in curved.items():
        (lat, lon), (end_lat, end_lon) = sector.fixes[start], sector.fixes[end]
        lons, lats = np.array(WGS84.npts(lon, lat, end_lon, end_lat, 200)).T
        geodesic = sector.plane.to_plane(lats, lons)
        order = np.argsort(points[:, 0])
        north_nm = np.interp(geodesic[:, 0], points[order, 0], points[order, 1])
        np.testing.assert_allclose(north_nm, geodesic[:, 1], atol=0.06)
        straight_nm = np.interp(
            geodesic[:, 0], points[order[[0, -1]], 0], points[order[[0, -1]], 1]
        )
        assert np.max(geodesic[:, 1] - straight_nm) > 2.0


def test_flight_across_the_antimeridian_is_continuous(fly):
    """It moves by the same distance in every row, and stays within the drawn area."""
    aircraft = {"callsign": "AC1", "lat": -17.7, "lon": 179.9, "fl": 300, "heading_deg": 90}
    route = {"route": ["SOUTO", "SOUTH", "MIDDL", "NORTH", "NORTO"]}
    scenario = {"sector": "dateline.json", "cycles": 30, "aircraft": [aircraft | route]}
    replay = read_replay(fly("dateline", scenario))
    (flown,) = replay.scenarios[0].aircraft
    steps_nm = np.diff(flown.position_nm[:, 0])
    np.testing.assert_allclose(steps_nm, steps_nm[0], rtol=0.01)
    assert 0.5 < steps_nm[0] < 1.0
    area = np.array(page_data((replay,))["sector"]["area"])
    assert np.ptp(area[:, 0]) < 500.0
    assert np.all((flown.position_nm > area.min(axis=0)) & (flown.position_nm < area.max(axis=0)))
