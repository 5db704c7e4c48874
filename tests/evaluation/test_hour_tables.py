"""The tables of flown hours, against the hour itself."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hour_scores import score
from skystack.evaluation.hour_tables import (
    TABLES,
    FlownHour,
    callsigns_of,
    growing_hours,
    tables_of,
)
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.losses import FlightPath, losses
from skystack.evaluation.traffic import evaluate_traffic
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.evaluation.writing import TrafficRecord
from skystack.reporting.replay.recording import read_replay
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import TICKS_PER_FL

CYCLES = 200


@pytest.fixture(scope="module")
def flown():
    """Crowded traffic under a controller that turns, climbs and clears direct."""
    conditions = TrafficConditions("150", cycles=CYCLES)
    found = find_controller("rules", conditions)
    hour = HourFlyer(found.world, CYCLES).fly(found.agent, seed=4, number=7)
    return FlownHour(found.world, hour, score(found.world.sector, hour))


@pytest.fixture(scope="module")
def tables(flown):
    return {name: table.to_pylist() for name, table in tables_of(flown).items()}


@pytest.mark.slow
def test_every_flight_has_a_row_for_each_cycle_from_its_birth_to_its_end(flown, tables):
    hour = flown.hour
    assert len(tables["trajectories"]) == int((hour.flight != FREE).sum())
    cycles = {}
    for row in tables["trajectories"]:
        cycles.setdefault(row["callsign"], []).append(row["cycle"])
    for row in tables["aircraft"]:
        first = row["birth_cycle"]
        last = CYCLES if row["gone_cycle"] is None else row["gone_cycle"]
        assert cycles[row["callsign"]] == list(range(first, last + 1))
    assert any(row["gone_cycle"] for row in tables["aircraft"])


@pytest.mark.slow
def test_positions_and_levels_are_those_after_the_cycle(flown, tables):
    plane, traffic = flown.world.sector.plane, flown.hour.traffic
    for row in tables["trajectories"][:: len(tables["trajectories"]) // 50]:
        cycle, number = row["cycle"] - 1, callsigns_of(flown.hour).index(row["callsign"])
        (slot,) = np.flatnonzero(flown.hour.flight[cycle] == number)
        at = plane.to_plane(np.array([row["lat"]]), np.array([row["lon"]]))[0]
        np.testing.assert_allclose(at, traffic.position_nm[cycle, slot], atol=1e-4)
        assert row["fl"] * TICKS_PER_FL == pytest.approx(traffic.level_ticks[cycle, slot], abs=1)


@pytest.mark.slow
def test_the_status_tells_how_a_flight_ended(tables):
    last = {row["callsign"]: row["status"] for row in tables["trajectories"]}
    for row in tables["aircraft"]:
        ended = last[row["callsign"]]
        assert (ended == "exited") == row["exited"]
        assert (ended == "excursion") == row["excursion"]
        assert not row["correct_exit"] or row["exited"]
        assert (row["exit_offset_nm"] is None) == (not row["exited"])


@pytest.mark.slow
def test_clearances_are_in_words_and_in_order(flown, tables):
    rows = tables["clearances"]
    assert {row["transmission"] for row in rows} == set(range(len(flown.hour.sent)))
    kinds = {row["kind"] for row in rows}
    assert kinds == {"heading", "direct", "level"}
    routes = {row["callsign"]: row["route"].split() for row in tables["aircraft"]}
    for row in rows:
        assert row["text"].startswith(row["callsign"])
        value = row["value"]
        if row["kind"] == "heading":
            assert f"heading {value % 360 or 360:03d}" in row["text"]
        elif row["kind"] == "level":
            assert f"FL{value}" in row["text"]
        else:
            assert f"direct {routes[row['callsign']][value]}" in row["text"]
    with_both = [row for row in rows if "direct" in row["text"] and "FL" in row["text"]]
    assert len(with_both) == 2 * len({row["transmission"] for row in with_both})


def test_a_turn_is_worded_as_it_is_flown(flown, tables):
    for row in tables["clearances"]:
        if row["kind"] == "heading" and row["direction"] is not None:
            cycle, number = row["cycle"], callsigns_of(flown.hour).index(row["callsign"])
            slots = np.flatnonzero(flown.hour.flight[min(cycle + 1, CYCLES - 1)] == number)
            if cycle + 1 < CYCLES and len(slots):
                heading = flown.hour.traffic.heading_deg[:, slots[0]]
                turned = (heading[cycle + 1] - heading[cycle] + 180.0) % 360.0 - 180.0
                assert (turned > 0.0) == (row["direction"] == "right")


def test_losses_found_in_the_tables_are_those_that_were_scored(flown, tables):
    """The replay computes losses from the trajectories, the scores from the motion in a cycle."""
    plane = flown.world.sector.plane
    paths, names = [], []
    for row in tables["aircraft"]:
        own = [each for each in tables["trajectories"] if each["callsign"] == row["callsign"]]
        degrees = (np.array([each[name] for each in own]) for name in ("lat", "lon"))
        levels = np.array([each["fl"] for each in own])
        paths.append(FlightPath(plane.to_plane(*degrees), levels, row["birth_cycle"]))
        names.append(row["callsign"])
    found = {
        (names[loss.first], names[loss.second]): loss.begins
        for loss in reversed(list(losses(flown.world.sector, paths)))
    }
    scored = {(row["first"], row["second"]): row["cycle"] - 1 for row in tables["losses"]}
    assert len(scored) > 3
    assert found == scored


def test_tables_appear_together_or_not_at_all(flown, tmp_path):
    traffic = TrafficRecord("rules", "150", 4, uncertainty=False)
    folder = tmp_path / "new"

    def fail():
        with growing_hours(folder, flown.world, "constant", traffic) as add:
            add(flown.hour, flown.scores)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert not folder.exists()
    with growing_hours(folder, flown.world, "constant", traffic) as add:
        add(flown.hour, flown.scores)
    assert {path.stem for path in folder.glob("*.parquet")} == set(TABLES)
    assert pq.read_table(folder / "aircraft.parquet").num_rows == len(flown.scores.flights)


@pytest.mark.slow
def test_hours_without_flights_are_written_with_others(tmp_path):
    """One flight an hour: most short hours are empty."""
    conditions = TrafficConditions("3", cycles=60, hours=4)
    evaluate_traffic("no-op", conditions, tmp_path)
    (folder,) = tmp_path.iterdir()
    flights = pq.read_table(folder / "episodes.parquet")["flights"].to_pylist()
    assert 0 in flights
    assert any(flights)
    replay = read_replay(folder)
    assert [len(each.aircraft) for each in replay.scenarios] == flights


@pytest.mark.slow
def test_a_callsign_is_the_same_flight_under_every_agent():
    found = {}
    for agent in ("no-op", "own-navigation-exit-level"):
        conditions = TrafficConditions("200", cycles=150)
        flown = find_controller(agent, conditions)
        hour = HourFlyer(flown.world, 150).fly(flown.agent, seed=0, number=0)
        tables = tables_of(FlownHour(flown.world, hour, score(flown.world.sector, hour)))
        planned = ("route", "entry_fl", "exit_fl")
        rows = tables["aircraft"].to_pylist()
        found[agent] = {row["callsign"]: [row[name] for name in planned] for row in rows}
        assert len(found[agent]) == len(rows)
    one, other = found.values()
    common = set(one) & set(other)
    assert len(common) > 10
    assert set(one) != set(other)
    assert all(one[each] == other[each] for each in common)


def test_candidates_that_are_used_again_have_another_callsign(flown):
    hour = flown.hour._replace(candidate=np.zeros_like(flown.hour.candidate))
    assert callsigns_of(hour)[:3] == ["AC1", "AC1-2", "AC1-3"]
