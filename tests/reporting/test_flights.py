"""Reading an evaluation's Parquet tables, and grouping clearances into bursts."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.reporting.flights import (
    FlownScenario,
    IssuedClearance,
    Start,
    Track,
    read_outcomes,
    read_scenario,
    read_starts,
)

FOLDER = "evaluation/lateral-s0-skystack-stacked"


def clearance(cycle, direction="right", kind="heading", value=90):
    return IssuedClearance(cycle, 6 * cycle, kind, value, direction, 1, "")


def track(*clearances):
    level = np.full(3, 300.0)
    return Track("AC1", np.zeros((2, 2)), np.zeros((3, 2)), level, level, 300, None, clearances)


def test_scenario_agrees_with_the_tables(run):
    folder = run / FOLDER
    scenario = read_scenario(folder, 1)
    assert scenario.sector == x_plus()
    assert [one.callsign for one in scenario.tracks] == ["AC1", "AC2"]
    assert sum(len(one.clearances) for one in scenario.tracks) == scenario.clearances
    rows = pq.read_table(folder / "trajectories.parquet").to_pylist()
    flown = [row for row in rows if row["scenario"] == 1 and row["callsign"] == "AC2"]
    start = scenario.sector.plane.to_plane(flown[0]["lat"], flown[0]["lon"])
    np.testing.assert_allclose(scenario.tracks[1].position_nm[0], start)


def test_track_ends_at_the_exit(run):
    path = run / FOLDER / "trajectories.parquet"
    table = pq.read_table(path)
    cycle = table["cycle"].to_numpy()
    status = pa.array(
        np.where(cycle >= 7, "exited", np.where(cycle >= 4, "excursion", "in_sector"))
    )
    changed = table.set_column(table.column_names.index("status"), "status", status)
    pq.write_table(changed.replace_schema_metadata(table.schema.metadata), path)
    for one in read_scenario(run / FOLDER, 0).tracks:
        assert len(one.position_nm) == 8
        assert one.excursion_cycle == 4


def test_reads_the_outcomes_of_the_first_scenarios(run):
    outcomes = read_outcomes(run / FOLDER, 1)
    assert outcomes.scenario.tolist() == [0]
    assert outcomes.success.dtype == bool


def test_bursts_end_at_a_gap_or_another_direction():
    clearances = [
        clearance(1, "right", value=350),
        clearance(2, "right", value=0),
        clearance(4, "right", value=10),
        clearance(7, "right", value=20),
        clearance(8, "left", value=10),
        clearance(9, "left", value=0),
        clearance(10, "left", value=350),
    ]
    bursts = track(*clearances).bursts
    assert [[one.cycle for one in burst] for burst in bursts] == [[1, 2, 4], [7], [8, 9, 10]]


def test_reversed_turn_ends_a_burst():
    """All are right turns for the aircraft, which has not reached these headings yet."""
    there_and_back = [clearance(1, value=90), clearance(2, value=80), clearance(3, value=90)]
    bursts = track(*there_and_back).bursts
    assert [[one.cycle for one in burst] for burst in bursts] == [[1], [2, 3]]


def test_groups_level_clearances_into_bursts():
    climb = [clearance(n, "climb", "level", 200 + 10 * n) for n in range(4)]
    descent = [clearance(4 + n, "descend", "level", 230 - 10 * n) for n in range(1, 3)]
    assert [len(burst) for burst in track(*climb, *descent).bursts] == [4, 2]


@given(st.lists(st.tuples(st.integers(0, 300), st.sampled_from(["left", "right"]))))
def test_bursts_keep_every_clearance_in_order(issued):
    clearances = tuple(clearance(*one) for one in sorted(issued))
    bursts = track(*clearances).bursts
    assert tuple(one for burst in bursts for one in burst) == clearances
    assert all(len({one.direction for one in burst}) == 1 for burst in bursts)


@pytest.mark.parametrize(
    ("one", "short"),
    [
        (clearance(0, "left", "heading", 35), "left 035"),
        (clearance(0, "climb", "level", 340), "climb FL340"),
    ],
)
def test_short_text_of_a_clearance(one, short):
    assert one.short == short


@pytest.mark.parametrize("name", ["episodes", "aircraft", "trajectories", "clearances"])
@pytest.mark.parametrize("damage", ["missing", "truncated", "other columns"])
def test_names_missing_and_damaged_tables_in_one_line(run, name, damage):
    path = run / FOLDER / f"{name}.parquet"
    if damage == "missing":
        path.unlink()
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    else:
        pq.write_table(pa.table({"scenario": [0]}), path)
    with pytest.raises(InputError, match=rf"{name}\.parquet") as error:
        read_scenario(run / FOLDER, 0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("metadata", [None, {b"sector": b"{}"}])
def test_rejects_a_table_without_a_sector(run, metadata):
    path = run / FOLDER / "trajectories.parquet"
    pq.write_table(pq.read_table(path).replace_schema_metadata(metadata), path)
    with pytest.raises(InputError, match=r"trajectories\.parquet.*sector"):
        read_scenario(run / FOLDER, 0)


def test_rejects_an_unknown_scenario(run):
    with pytest.raises(InputError, match="no scenario 17"):
        read_scenario(run / FOLDER, 17)


def level_track(callsign, *positions_nm, fl=300.0):
    path = np.array(positions_nm, dtype=float)
    level = np.full(len(path), fl)
    return Track(callsign, path[:0], path, level, level, 300, None, ())


def least_separation(*tracks):
    return FlownScenario(x_plus(), 0, 0, tracks).least_separation


def test_least_separation_is_found_between_radar_positions():
    # They pass each other at 3 NM, half-way through the second cycle.
    east = level_track("AC1", (-1.5, 0.0), (-0.5, 0.0), (0.5, 0.0), (1.5, 0.0))
    west = level_track("AC2", (1.5, 3.0), (0.5, 3.0), (-0.5, 3.0), (-1.5, 3.0))
    nearest = least_separation(east, west)
    assert nearest.distance_nm == pytest.approx(3.0)
    np.testing.assert_allclose(nearest.position_nm, [[0.0, 0.0], [0.0, 3.0]], atol=1e-12)


def test_least_separation_ends_when_one_aircraft_has_exited():
    short = level_track("AC1", (0.0, 0.0), (1.0, 0.0))
    long = level_track("AC2", (9.0, 0.0), (8.0, 0.0), (1.0, 0.0))
    assert least_separation(short, long).distance_nm == pytest.approx(7.0)


def test_no_least_separation_of_aircraft_1000_ft_apart():
    low, high = level_track("AC1", (0.0, 0.0)), level_track("AC2", (1.0, 0.0), fl=310.0)
    assert least_separation(low, high) is None
    assert least_separation(low) is None


def test_starts_contain_routes_and_level_changes(run):
    rows = pq.read_table(run / FOLDER / "aircraft.parquet").to_pylist()
    (start,) = read_starts(run / FOLDER, [1])
    assert [" ".join(route) for route in start.routes] == [
        row["route"] for row in rows if row["scenario"] == 1
    ]
    assert start.climbs_fl == (0, 0)
    with pytest.raises(InputError, match=r"aircraft\.parquet: has no scenario 7"):
        read_starts(run / FOLDER, [7])


def test_routes_are_reciprocal_if_one_is_the_other_reversed():
    there, back, aside = ("A", "B", "C"), ("C", "B", "A"), ("A", "B", "D")
    assert Start((there, back), (0, 0)).reciprocal
    assert Start((there, aside, back), (0, 0, 0)).reciprocal
    assert not Start((there, there), (0, 0)).reciprocal
    assert not Start((there, aside), (0, 0)).reciprocal
    assert not Start((there,), (0,)).reciprocal
