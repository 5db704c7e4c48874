"""Replays of hours of arriving traffic: flights appear and disappear."""

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.errors import InputError
from skystack.evaluation.stored import MAX_FLIGHTS, stored_scenario
from skystack.evaluation.traffic import evaluate_traffic
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.reporting.replay.film import SHORT_TRAIL, _trail, write_picture
from skystack.reporting.replay.page import PARTS, page_data, write_replay
from skystack.reporting.replay.recording import read_replay
from skystack.reporting.replay.side_by_side import read_side_by_side

from .browser import viewing

CYCLES = 150


@pytest.fixture(scope="module")
def hours(tmp_path_factory):
    """Folders of two agents in the same traffic, and of other traffic."""
    out = tmp_path_factory.mktemp("hours")
    rows = {}
    for agent, seed in (("rules", 0), ("own-navigation", 0), ("no-op", 1)):
        conditions = TrafficConditions("120", hours=2, cycles=CYCLES, seed=seed)
        rows[agent] = evaluate_traffic(agent, conditions, out)
    folders = {
        agent: next(path for path in out.iterdir() if path.name.startswith(f"{agent}-traffic"))
        for agent in rows
    }
    return rows, folders


@pytest.fixture(scope="module")
def folder(hours):
    return hours[1]["rules"]


@pytest.fixture(scope="module")
def page(folder, tmp_path_factory):
    file = tmp_path_factory.mktemp("page") / "hours.html"
    write_replay([folder], file)
    return file


@pytest.mark.slow
def test_an_hour_has_its_flights_and_no_verdict(hours, folder):
    row = hours[0]["rules"]
    replay = read_replay(folder)
    assert replay.title == "rules, 120 flights/h"
    assert [each.number for each in replay.scenarios] == [0, 1]
    assert sum(len(each.aircraft) for each in replay.scenarios) == row["flights"]
    assert {each.success for each in replay.scenarios} == {None}
    lost = [{(loss.first, loss.second) for loss in each.losses} for each in replay.scenarios]
    assert sum(map(len, lost)) == row["losses_of_separation"] > 0
    told = sum(len(each.transmissions) for each in replay.scenarios)
    assert told == pytest.approx(row["transmissions_per_flight"] * row["flights"])


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["rules", "own-navigation"])
def test_excursions_and_wrong_levels_are_named(hours, agent):
    folder = hours[1][agent]
    aircraft = pq.read_table(folder / "aircraft.parquet").to_pylist()
    found = []
    for scenario in read_replay(folder).scenarios:
        own = [row for row in aircraft if row["scenario"] == scenario.number]
        named = {each.reason: each.aircraft for each in scenario.failures}
        strayed = tuple(n for n, row in enumerate(own) if row["excursion"])
        wrong = tuple(n for n, row in enumerate(own) if row["exited"] and not row["correct_exit"])
        assert named.get("excursion", ()) == strayed
        assert named.get("wrong_exit_level", ()) == wrong
        found += [*strayed, *wrong]
    assert found


@pytest.mark.slow
def test_the_page_has_every_flight_from_its_birth(folder):
    replay = read_replay(folder)
    (run,) = page_data((replay,))["runs"]
    for flown, packed in zip(
        replay.scenarios[1].aircraft, run["scenarios"][1]["aircraft"], strict=True
    ):
        assert packed["begins"] == flown.begins >= 1
        assert packed["rows"] == len(flown.fl)
        east = np.zeros(packed["rows"])
        east[: len(packed["x"])] = packed["x"]
        whole = np.cumsum(np.cumsum(east)) / PARTS["nm"]
        np.testing.assert_allclose(whole, flown.position_nm[:, 0], atol=1.0 / PARTS["nm"])


def test_agents_in_the_same_traffic_can_be_compared(hours):
    _, folders = hours
    one, other = read_side_by_side([folders["rules"], folders["own-navigation"]])
    assert [each.number for each in one.scenarios] == [each.number for each in other.scenarios]
    with pytest.raises(
        InputError, match="no-op, 120 flights/h and rules, 120 flights/h have different traffic"
    ):
        read_side_by_side([folders["rules"], folders["no-op"]])


@pytest.mark.slow
def test_hours_of_different_lengths_cannot_be_compared(hours, tmp_path):
    folder = hours[1]["rules"]
    conditions = TrafficConditions("120", hours=2, cycles=20)
    evaluate_traffic("rules", conditions, tmp_path)
    (short,) = tmp_path.iterdir()
    with pytest.raises(InputError, match="hours of different lengths"):
        read_side_by_side([folder, short])


def test_hours_and_scenarios_cannot_be_compared(folder, evaluation):
    for runs in ([folder, evaluation], [evaluation, folder]):
        with pytest.raises(InputError, match="have different traffic"):
            read_side_by_side(runs)


def test_trails_are_short_and_end_with_the_flight(folder, tmp_path):
    scenario = read_replay(folder).scenarios[0]
    number, flown = next(
        (n, each)
        for n, each in enumerate(scenario.aircraft)
        if each.ends <= CYCLES and len(each.fl) > SHORT_TRAIL + 5
    )
    last = flown.ends - 1
    np.testing.assert_array_equal(
        _trail(scenario, number, 0, last), flown.position_nm[-SHORT_TRAIL - 1 :]
    )
    assert len(_trail(scenario, number, 0, flown.begins + 3)) == 4
    assert len(_trail(scenario, number, 0, flown.begins - 1)) == 0
    assert len(_trail(scenario, number, 0, last + 1)) == 0
    written = write_picture([folder], tmp_path / "moment.png", 0, to_s=6 * CYCLES)
    assert written["bytes"] > 10_000
    written = write_picture([folder], tmp_path / "film.gif", 0, from_s=600, to_s=630)
    assert written["bytes"] > 10_000


def test_hours_are_not_scenarios_to_fly_again(folder):
    with pytest.raises(InputError, match="hours of arriving traffic cannot be flown again"):
        stored_scenario(folder, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda row: row | {"birth_cycle": row["birth_cycle"] + 1}, "are not complete"),
        (lambda row: row | {"birth_cycle": 1_000_000_000}, "are not complete"),
        (lambda row: row | {"callsign": "AC1"}, "AC1 appears twice"),
    ],
)
def test_damaged_tables_are_refused(folder, tmp_path, change, message):
    copy = shutil.copytree(folder, tmp_path / "copy")
    path = copy / "aircraft.parquet"
    table = pq.read_table(path)
    rows = table.to_pylist()
    rows[2] = change(rows[2])
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    with pytest.raises(InputError, match=message):
        read_replay(copy)


def test_the_number_of_flights_is_limited(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    path = copy / "aircraft.parquet"
    table = pq.read_table(path)
    many = pa.concat_tables([table] * (MAX_FLIGHTS // 10))
    pq.write_table(many.replace_schema_metadata(table.schema.metadata), path)
    with pytest.raises(InputError, match=f"allowed: {MAX_FLIGHTS}"):
        read_replay(copy)


@pytest.mark.slow
def test_strips_are_those_of_the_flights_that_are_about(browser, folder, page):
    scenario = read_replay(folder).scenarios[0]
    with viewing(browser, page) as viewer:
        for row in (0, 60, CYCLES):
            viewer.scrub_to(row)
            shown = viewer.page.locator(".strips li:not([hidden]) .callsign").all_text_contents()
            about = [
                each.callsign for each in scenario.aircraft if each.begins <= row < each.ends + 20
            ]
            assert shown == about
        assert about
        verdict = viewer.page.locator(".verdict").text_content()
        assert "excursion" in verdict
        assert verdict.endswith("separation lost")


@pytest.mark.slow
def test_a_flight_can_be_selected_and_its_levels_drawn(browser, folder, page):
    scenario = read_replay(folder).scenarios[0]
    flown = next(each for each in scenario.aircraft if each.begins > 20)
    with viewing(browser, page, link=f"scenario=0&cycle={flown.begins}") as viewer:
        viewer.page.fill("#find", flown.callsign)
        viewer.keys("Enter")
        assert viewer.selected == [flown.callsign]
        viewer.keys("g")
        caption = viewer.page.locator(".profile h3").text_content()
        assert f"{flown.callsign} FL{flown.fl[0]:03.0f}" in caption
        viewer.scrub_to(0)  # before it appears
        viewer.scrub_to(CYCLES)
        viewer.settle()


@pytest.mark.slow
def test_two_agents_are_drawn_side_by_side(browser, hours, tmp_path):
    _, folders = hours
    file = tmp_path / "both.html"
    write_replay([folders["rules"], folders["own-navigation"]], file)
    with viewing(browser, file, link="scenario=1&cycle=100") as viewer:
        titles = viewer.page.locator(".pane h2").all_text_contents()
        assert titles == ["rules, 120 flights/h", "own-navigation, 120 flights/h"]
        viewer.page.locator(".strips li:not([hidden]) button").first.click()
        viewer.play(5, 400, "scrubber.valueAsNumber")
