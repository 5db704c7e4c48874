"""Replays agree with the tables; files that cannot be read are rejected."""

import shutil
from itertools import combinations

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation.losses import FlightPath, losses
from skystack.evaluation.stored import stored_scenario
from skystack.evaluation.writing import write_table
from skystack.reporting.replay.recording import as_json, read_replay

from .conftest import SCENARIOS
from .meeting import AHEAD_NM, BESIDE_NM, CLOSING_NM, EVIL, FIRST_LOSS, LAST_LOSS, meeting

TABLES = ("episodes", "aircraft", "trajectories", "clearances")


@pytest.fixture
def copied(evaluation, tmp_path):
    return shutil.copytree(evaluation, tmp_path / evaluation.name)


def rows_of(folder, table):
    return pq.read_table(folder / f"{table}.parquet").to_pylist()


def test_reads_an_evaluation(evaluation):
    replay = read_replay(evaluation)
    episodes = rows_of(evaluation, "episodes")
    assert replay.title == "avoidance, stacked"
    assert [scenario.number for scenario in replay.scenarios] == list(range(SCENARIOS))
    for scenario, episode in zip(replay.scenarios, episodes, strict=True):
        assert (scenario.cycles, scenario.success) == (episode["cycles"], episode["success"])
        assert len(scenario.clearances) == episode["clearances"]
        assert sum(each.instructions for each in scenario.clearances) == episode["instructions"]
    clearances = [
        (scenario.number, each.cycle, scenario.aircraft[each.aircraft].callsign, each.text)
        for scenario in replay.scenarios
        for each in scenario.clearances
    ]
    table = rows_of(evaluation, "clearances")
    columns = ("scenario", "cycle", "callsign", "text")
    assert sorted(clearances) == sorted(tuple(row[name] for name in columns) for row in table)


def test_positions_agree_with_the_trajectories(evaluation):
    replay = read_replay(evaluation, scenarios=2)
    for row in rows_of(evaluation, "trajectories"):
        if row["scenario"] >= 2:
            continue
        aircraft = replay.scenarios[row["scenario"]].aircraft
        (flown,) = (each for each in aircraft if each.callsign == row["callsign"])
        if row["cycle"] >= len(flown.status):
            assert flown.status[-1] == row["status"] == "exited"
            continue
        lat, lon = replay.sector.plane.to_degrees(flown.position_nm[row["cycle"]])
        assert (lat, lon) == pytest.approx((row["lat"], row["lon"]), abs=1e-9)
        assert flown.status[row["cycle"]] == row["status"]
        assert flown.cleared_heading_deg[row["cycle"]] == row["cleared_heading_deg"]


def test_losses_agree_with_the_evaluation(evaluation):
    """The evaluation counts losses during the flight, with the code of the tasks."""
    replay, episodes = read_replay(evaluation), rows_of(evaluation, "episodes")
    assert any(episode["loss_of_separation"] for episode in episodes)
    for scenario, episode in zip(replay.scenarios, episodes, strict=True):
        assert bool(scenario.losses) == episode["loss_of_separation"]
        if scenario.losses:
            least = min(loss.least_nm for loss in scenario.losses)
            assert least == pytest.approx(episode["min_separation_nm"], abs=1e-3)


def test_reads_the_output_of_simulate(one_by_one):
    replay = read_replay(one_by_one)
    (scenario,) = replay.scenarios
    assert (replay.title, scenario.cycles, scenario.success) == ("one &amp; <b>one", 60, None)
    first, second = scenario.aircraft
    assert (first.callsign, first.exit_fl) == (EVIL, 300)
    cycle = np.arange(41)
    np.testing.assert_allclose(first.position_nm[:41, 0], -AHEAD_NM / 2 + cycle * 2 / 3, atol=1e-3)
    np.testing.assert_allclose(second.position_nm[:41, 1], BESIDE_NM, atol=1e-3)
    assert [(each.cycle, each.aircraft, each.text) for each in scenario.clearances] == [
        (40, 1, "AC2 turn right heading 280"),
        (41, 1, "AC2 turn right heading 290"),
        (45, 0, f"{EVIL} climb FL320"),
    ]


def test_loss_is_between_the_rows_given_by_the_formula(one_by_one):
    (loss,) = read_replay(one_by_one).scenarios[0].losses
    along = AHEAD_NM - CLOSING_NM * np.arange(61)
    apart = np.hypot(along, BESIDE_NM)
    close = np.flatnonzero(apart < 5.0)
    assert (close[0] - 1, close[-1] + 1) == (FIRST_LOSS, LAST_LOSS)
    assert (loss.begins, loss.ends) == (FIRST_LOSS, LAST_LOSS)
    assert loss.least_nm == pytest.approx(BESIDE_NM, abs=1e-3)


def test_finds_the_only_evaluation_in_a_folder(evaluation):
    assert read_replay(evaluation.parent, scenarios=1).title == "avoidance, stacked"


def test_names_the_evaluations_if_there_are_several(copied):
    shutil.copytree(copied, copied.parent / "other")
    with pytest.raises(InputError, match=f"2 evaluations: choose one or two of {copied.name}, oth"):
        read_replay(copied.parent)


@pytest.mark.parametrize("table", TABLES)
def test_names_a_missing_or_damaged_table(copied, table):
    path = copied / f"{table}.parquet"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=rf"{table}\.parquet: damaged"):
        read_replay(copied)
    path.unlink()
    with pytest.raises(InputError, match=rf"{table}\.parquet: missing"):
        read_replay(copied)


def rewrite(folder, table, change):
    path, sector = folder / f"{table}.parquet", read_replay(folder, 1).sector
    write_table(path, change(pq.read_table(path)), sector, "table")


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        ("trajectories", lambda t: t.drop_columns("fl"), "no column 'fl'"),
        ("trajectories", lambda t: t.slice(1), "the rows of AC1 are not complete"),
        ("trajectories", lambda t: t.filter(t["scenario"].to_numpy() != 1), "agree on scenario 1"),
        ("trajectories", lambda t: t.filter(t["cycle"].to_numpy() < 2), "agree on scenario 0"),
        ("clearances", lambda t: t.slice(1), "agree on scenario 0"),
        ("clearances", lambda t: t.slice(0, 0), "agree on scenario 0"),
        ("aircraft", lambda t: t.slice(1), "is for 'AC1', which does not fly"),
        ("episodes", lambda t: t.slice(0, 0), "contains no scenario"),
    ],
    ids=["column", "row", "scenario", "cycles", "clearance", "no clearances", "aircraft", "empty"],
)
def test_rejects_inconsistent_tables(copied, table, change, message):
    rewrite(copied, table, change)
    with pytest.raises(InputError, match=message):
        read_replay(copied)


@pytest.mark.parametrize("table", TABLES)
def test_rejects_a_table_of_another_evaluation(copied, table, tmp_path):
    """Even if the numbers of rows and clearances are the same."""
    read_replay(copied)
    path = copied / f"{table}.parquet"
    read = pq.read_table(path)
    metadata = read.schema.metadata | {b"evaluation": b"another"}
    pq.write_table(read.replace_schema_metadata(metadata), path)
    with pytest.raises(InputError, match="its tables are from different evaluations"):
        read_replay(copied)
    with pytest.raises(InputError, match="its tables are from different evaluations"):
        stored_scenario(copied, 0)


def test_rejects_paths_without_an_evaluation(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_replay(tmp_path / "nowhere")
    with pytest.raises(InputError, match="contains no evaluation"):
        read_replay(tmp_path)
    (tmp_path / "scenario.json").write_text("{}")
    with pytest.raises(InputError, match="damaged"):
        read_replay(tmp_path / "scenario.json")


def test_rejects_a_single_table_of_an_evaluation(evaluation):
    with pytest.raises(InputError, match="has no aircraft in its metadata"):
        read_replay(evaluation / "trajectories.parquet")


def test_json_never_ends_a_script_element():
    assert "<" not in as_json({"callsign": "</script><script>"})


def level_path(place, fl):
    return FlightPath(place, np.full(len(place), fl))


def test_losses_among_flights_of_different_lengths():
    """Compared with brute force: a hundred positions per cycle."""
    random = np.random.default_rng(3)
    rows = (700, 130, 512, 513, 2)  # above, below and at the limits of a block of cycles
    places = [np.cumsum(random.normal(0.0, 0.4, (count, 2)), axis=0) for count in rows]
    levels = (300.0, 305.0, 309.0, 300.0, 325.0)  # the last is vertically separated from all
    flown = tuple(level_path(*each) for each in zip(places, levels, strict=True))
    expected = {}
    for (first, one), (second, other) in combinations(enumerate(places), 2):
        both = min(len(one), len(other))
        apart = one[:both] - other[:both]
        part = np.linspace(0.0, 1.0, 101)[:, None, None]
        least = np.hypot(*np.moveaxis(apart[:-1] + part * np.diff(apart, axis=0), -1, 0)).min(0)
        if abs(levels[first] - levels[second]) < 10.0 and least.min() < 5.0:
            expected[first, second] = least
    found = list(losses(x_plus(), flown))
    assert {(loss.first, loss.second) for loss in found} == set(expected)
    for pair, least in expected.items():
        own = [loss for loss in found if (loss.first, loss.second) == pair]
        is_lost = np.zeros(len(least), dtype=bool)
        for loss in own:
            is_lost[loss.begins : loss.ends] = True
            assert loss.least_nm == pytest.approx(least[loss.begins : loss.ends].min(), abs=1e-2)
        np.testing.assert_array_equal(is_lost, least < 5.0)


def test_no_losses_of_flights_with_one_row():
    here = level_path(np.zeros((1, 2)), 300.0)
    assert list(losses(x_plus(), (here, here))) == []


def test_reads_a_single_scenario(evaluation):
    first, *_ = read_replay(evaluation, scenarios=SCENARIOS).scenarios[7:8]
    (alone,) = read_replay(evaluation, only=7).scenarios
    assert (alone.number, alone.clearances, alone.losses) == (7, first.clearances, first.losses)
    for one, other in zip(alone.aircraft, first.aircraft, strict=True):
        np.testing.assert_array_equal(one.position_nm, other.position_nm)
        assert one.status == other.status
    missing = rf"has no scenario {SCENARIOS} \(found: 0 to {SCENARIOS - 1}\)"
    with pytest.raises(InputError, match=missing):
        read_replay(evaluation, only=SCENARIOS)


def test_a_heading_and_a_level_at_once_are_one_transmission(fly):
    combined = {"cycle": 40, "callsign": "AC2", "heading_deg": 280, "fl": 320}
    later = {"cycle": 41, "callsign": "AC2", "heading_deg": 290}
    (scenario,) = read_replay(fly("combined", meeting(combined, later))).scenarios
    assert [each.kind for each in scenario.clearances] == ["heading", "level", "heading"]
    assert [each.text for each in scenario.transmissions] == [
        "AC2 turn right heading 280, climb FL320",
        "AC2 turn right heading 290",
    ]
