"""Scenario files: what is refused and how, and that they fly as BluebirdDT's reference rollouts."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.simulator.scenario_file import MAX_BYTES, fly, load_scenario, rows
from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, SHORTEST, ticks

SECTORS = {"x-plus": x_plus}
EXAMPLES = Path(__file__).parents[2] / "examples"
TANGENT_PLANE_NM = 0.04
"""How far the tangent plane may be off BluebirdDT's ellipsoid 140 to 190 NM from the origin."""
NORTHBOUND = ["HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT"]

MINIMAL = {
    "sector": "x-plus",
    "cycles": 12,
    "aircraft": [
        {"callsign": "AC1", "route": NORTHBOUND, "lat": -0.41, "lon": -0.41, "fl": 300},
        {"callsign": "AC2", "route": NORTHBOUND[::-1], "lat": 0.7, "lon": 0.7, "fl": 300},
    ],
    "clearances": [{"cycle": 3, "callsign": "AC1", "heading_deg": 35}],
}


def changed(where, value):
    """The minimal scenario with one field set (or, for `...`, taken out)."""
    scenario = copy.deepcopy(MINIMAL)
    *steps, last = where
    at = scenario
    for step in steps:
        at = at[step]
    if value is ...:
        del at[last]
    else:
        at[last] = value
    return scenario


def load(scenario, folder):
    path = folder / "scenario.json"
    path.write_text(scenario if isinstance(scenario, str) else json.dumps(scenario))
    return load_scenario(path, SECTORS)


def flown(scenario):
    """Columns of the flown scenario as arrays `[cycles + 1, aircraft]`."""
    columns = rows(scenario, fly(scenario))
    return {name: column.reshape(scenario.cycles + 1, -1) for name, column in columns.items()}


A1, C0 = ("aircraft", 1), ("clearances", 0)
ONE_AIRCRAFT = MINIMAL["aircraft"][0]
REFUSED = [
    # Fields and types.
    (("levels",), 1, "unknown field 'levels'; did you mean 'levels_fl'? (allowed: aircraft, "),
    ((*A1, "callsing"), 1, "aircraft[1]: unknown field 'callsing'; did you mean 'callsign'? ("),
    ((*A1, "\ud800"), 1, "unknown field '\\ud800' (allowed: aircraft, callsign, clearances, cycle"),
    (("a\nb - at `$.x`",), 1, "unknown field 'a\\nb - at `$.x`' (allowed: aircraft, callsign, c"),
    ((*C0, "turns"), 1, "clearances[0]: unknown field 'turns'; did you mean 'turn'? (allowed: "),
    (("sector",), ..., "sector is missing"),
    ((*A1, "route"), ..., "aircraft[1].route is missing"),
    ((*C0, "callsign"), ..., "clearances[0].callsign is missing"),
    (("aircraft",), "AC1", 'aircraft is "AC1" (allowed: list)'),
    (("aircraft",), ["AC1"], 'aircraft[0] is "AC1" (allowed: object)'),
    ((*A1, "fl"), "high", 'aircraft[1].fl is "high" (allowed: number)'),
    ((*A1, "fl"), True, "aircraft[1].fl is true (allowed: number)"),
    ((*A1, "own_navigation"), 1, "aircraft[1].own_navigation is 1 (allowed: true or false)"),
    ((*C0, "heading_deg"), 35.5, "clearances[0].heading_deg is 35.5 (allowed: whole number)"),
    # The sector and the aircraft's names.
    (("sector",), "xplus", "sector: unknown sector 'xplus'; did you mean 'x-plus'? (allowed: x"),
    (("performance",), "tabel", "performance: unknown performance model 'tabel'; did you mean 't"),
    ((*A1, "type"), "A320", 'aircraft[1].type is "A320" (allowed: B753)'),
    (
        (*A1, "route", 2),
        "MACAU",
        "aircraft[1].route[2]: unknown fix 'MACAU'; did you mean 'MACAW'? (allowed: ALB, CRANE",
    ),
    (
        (*A1, "route"),
        ["EGL", "HERON"],
        "aircraft[1].route: route 'EGL HERON' is not a route of x-plus (allowed: HERON CRANE EGL F",
    ),
    ((*A1, "route"), ["EGL"], 'aircraft[1].route is ["EGL"] (allowed: list of length >= 2)'),
    (
        (*A1, "callsign"),
        "AC1",
        'aircraft[1].callsign is "AC1" (allowed: a callsign of its own, aircraft[0] has this one)',
    ),
    ((*A1, "callsign"), "", 'aircraft[1].callsign is "" (allowed: printable characters, none of'),
    ((*A1, "callsign"), " ", 'aircraft[1].callsign is " " (allowed: printable characters, none'),
    ((*A1, "callsign"), "A\nB", 'aircraft[1].callsign is "A\\nB" (allowed: printable characters'),
    ((*A1, "callsign"), "\ud800", 'aircraft[1].callsign is "\\ud800" (allowed: printable charac'),
    (("aircraft",), [], "aircraft is [] (allowed: list of length >= 1)"),
    (("aircraft",), [ONE_AIRCRAFT] * 201, 'aircraft is [{"callsign": "AC1", "route": ["HERON", "'),
    # Where they are and what they fly.
    ((*A1, "lat"), 91, "aircraft[1].lat is 91 (allowed: number <= 90.0)"),
    ((*A1, "lon"), -181, "aircraft[1].lon is -181 (allowed: number >= -180.0)"),
    (
        (*A1, "lat"),
        4.3,
        "aircraft[1] is 260 NM from the origin of x-plus at lat 4.3, lon 0.7 "
        "(allowed: at most 250 NM)",
    ),
    ((*A1, "heading_deg"), 360.5, "aircraft[1].heading_deg is 360.5 (allowed: number <= 360.0)"),
    (("levels_fl",), [300, 200], "levels_fl is [300, 200] (allowed: the lowest level, then a hi"),
    (("levels_fl",), [200, 305], "levels_fl[1] is 305 (allowed: whole number that's a multiple"),
    (("levels_fl",), [200, 610], "levels_fl[1] is 610 (allowed: whole number <= 600)"),
    (("levels_fl",), [200], "levels_fl is [200] (allowed: list of length 2)"),
    ((*A1, "fl"), 400.5, "aircraft[1].fl is 400.5 (allowed: 200 to 400)"),
    ((*A1, "exit_fl"), 305, "aircraft[1].exit_fl is 305 (allowed: multiples of 10 from 200 to 40"),
    ((*A1, "exit_fl"), 410, "aircraft[1].exit_fl is 410 (allowed: multiples of 10 from 200 to 40"),
    ((*A1, "fl"), 300.5, "aircraft[1].exit_fl (not given, so fl) is 300.5 (allowed: multiples o"),
    # Clearances.
    (("cycles",), 0, "cycles is 0 (allowed: whole number >= 1)"),
    (("cycles",), 10_001, "cycles is 10001 (allowed: whole number <= 10000)"),
    ((*C0, "callsign"), "AC3", "clearances[0].callsign: unknown callsign 'AC3'; did you mean 'A"),
    ((*C0, "cycle"), 12, "clearances[0].cycle is 12 (allowed: 0 to 11, which is cycles - 1)"),
    ((*C0, "cycle"), -1, "clearances[0].cycle is -1 (allowed: 0 to 11, which is cycles - 1)"),
    ((*C0, "heading_deg"), ..., "clearances[0] clears nothing (allowed: heading_deg, fl or both)"),
    ((*C0, "heading_deg"), 361, "clearances[0].heading_deg is 361 (allowed: whole number <= 360)"),
    ((*C0, "fl"), 335, "clearances[0].fl is 335 (allowed: multiples of 10 from 200 to 400)"),
    ((*C0, "fl"), 10**30, "clearances[0].fl is 1000000000000000000000000000000 (allowed: multip"),
    ((*C0, "turn"), "lefft", "clearances[0].turn: unknown turn 'lefft'; did you mean 'left'? (all"),
    (
        ("clearances", 0),
        {"cycle": 3, "callsign": "AC1", "fl": 310, "turn": "left"},
        'clearances[0].turn is "left" (allowed: only together with heading_deg)',
    ),
]


@pytest.mark.parametrize(("where", "value", "message"), REFUSED)
def test_a_bad_value_is_refused_in_one_line(where, value, message, tmp_path):
    with pytest.raises(InputError) as error:
        load(changed(where, value), tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'scenario.json'}: {message}")
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is not JSON (Expecting value: line 1 column 1 (char 0))"),
        (b'{"sector": }', "is not JSON (Expecting value: line 1 column 12 (char 11))"),
        (b"[1]", "the file is [1] (allowed: object)"),
        (b"[" * 100_000, "is not JSON (maximum recursion depth exceeded"),
        (b'{"sector": "\xff"}', "is not UTF-8 (byte 12)"),
        (b'{"cycles": NaN}', "NaN is no number of JSON (allowed: finite numbers)"),
        (
            b'{"cycles": 1, "cycles": 2}',
            "field 'cycles' stands twice in one object (allowed: once)",
        ),
        (b'{"cycles": 1' + b"0" * 5000 + b"}", "is not JSON (Exceeds the limit (4300 digits)"),
        (b" " * (MAX_BYTES + 1), "is too large (allowed: 10 MB)"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused(data, message, tmp_path):
    path = tmp_path / "scenario.json"
    path.write_bytes(data)
    with pytest.raises(InputError) as error:
        load_scenario(path, SECTORS)
    assert str(error.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize(
    ("number", "message"),
    [
        ("1e999", "aircraft[1].fl is Infinity (allowed: 200 to 400)"),
        ("1" + "0" * 400, f"aircraft[1].fl is 1{'0' * 59}... (allowed: finite number)"),
    ],
)
def test_a_number_beyond_floating_point_is_refused(number, message, tmp_path):
    text = json.dumps(changed((*A1, "fl"), "here")).replace('"here"', number)
    with pytest.raises(InputError) as error:
        load(text, tmp_path)
    assert str(error.value) == f"{tmp_path / 'scenario.json'}: {message}"


def test_a_file_that_is_not_there_is_refused(tmp_path):
    for path, why in [(tmp_path / "no.json", "No such file"), (tmp_path, "Is a directory")]:
        with pytest.raises(InputError) as error:
            load_scenario(path, SECTORS)
        assert str(error.value).startswith(f"{path}: cannot be read ({why}")


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=50),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)
PLACES = [
    *((field,) for field in MINIMAL),
    *((*A1, field) for field in [*ONE_AIRCRAFT, "heading_deg", "exit_fl", "type"]),
    *((*C0, field) for field in ["cycle", "callsign", "heading_deg", "fl", "turn"]),
    ("levels_fl",),
    A1,
    C0,
    (*A1, "route", 0),
]


@given(st.sampled_from(PLACES), JSON_VALUES)
def test_any_value_anywhere_is_taken_or_refused_in_one_line(tmp_path_factory, where, value):
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_text(json.dumps(changed(where, value)))
    try:
        scenario = load_scenario(path, SECTORS)
    except InputError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017
    else:
        low, high = scenario.sector.levels_fl
        assert all(low <= aircraft.fl <= high for aircraft in scenario.aircraft)
        assert all(0 <= given.cycle < scenario.cycles for given in scenario.clearances)


def test_what_is_not_given_has_the_documented_default(tmp_path):
    scenario = load(MINIMAL, tmp_path)
    aircraft = scenario.aircraft[0]
    sector = x_plus()
    assert scenario.sector == sector
    assert scenario.performance == "table"
    assert aircraft.type == "B753"
    assert aircraft.exit_fl == 300
    assert not aircraft.own_navigation
    # The first leg of the northbound routes, from the table of routes.
    assert aircraft.heading_deg == pytest.approx(45.1920, abs=1e-4)
    assert load(changed(("clearances",), ...), tmp_path).clearances == ()


def test_what_is_given_is_kept(tmp_path):
    given = {"type": "B753", "heading_deg": 360.0, "exit_fl": 250, "own_navigation": True}
    scenario = load(changed(A1, MINIMAL["aircraft"][1] | given), tmp_path)
    aircraft = scenario.aircraft[1]
    assert (aircraft.lat, aircraft.lon, aircraft.fl) == (0.7, 0.7, 300)
    assert (aircraft.heading_deg, aircraft.exit_fl, aircraft.own_navigation) == (0.0, 250, True)
    assert scenario.simulator().own_navigation
    assert not load(MINIMAL, tmp_path).simulator().own_navigation
    assert load(changed(("levels_fl",), [250, 350]), tmp_path).sector.levels_fl == (250, 350)


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(MINIMAL), encoding="utf-8-sig")
    assert load_scenario(path, SECTORS).cycles == 12


def told(tmp_path, *entries):
    """The clearance arrays of a minimal scenario with these entries of `clearances`."""
    return load(changed(("clearances",), list(entries)), tmp_path).clearances_by_cycle()


def test_clearances_stand_in_the_row_of_their_cycle(tmp_path):
    clearance = told(
        tmp_path,
        {"cycle": 3, "callsign": "AC2", "heading_deg": 360, "turn": "left", "fl": 340},
        {"cycle": 0, "callsign": "AC1", "fl": 200},
        {"cycle": 11, "callsign": "AC1", "heading_deg": 90},
    )
    turn, changes = np.full((12, 2), NO_TURN), np.zeros((12, 2), dtype=bool)
    turn[3, 1], turn[11, 0] = LEFT, SHORTEST
    changes[3, 1] = changes[0, 0] = True
    np.testing.assert_array_equal(clearance.turn, turn)
    np.testing.assert_array_equal(clearance.changes_level, changes)
    assert (clearance.heading_deg[3, 1], clearance.heading_deg[11, 0]) == (0.0, 90.0)
    assert (clearance.level[3, 1], clearance.level[0, 0]) == (ticks(340.0), ticks(200.0))


def test_of_two_entries_in_a_cycle_the_later_wins_and_leaves_what_it_does_not_name(tmp_path):
    clearance = told(
        tmp_path,
        {"cycle": 3, "callsign": "AC1", "heading_deg": 35, "turn": "right"},
        {"cycle": 3, "callsign": "AC1", "fl": 310},
        {"cycle": 3, "callsign": "AC1", "heading_deg": 40, "turn": "right"},
        {"cycle": 3, "callsign": "AC1", "fl": 320},
        {"cycle": 3, "callsign": "AC1", "heading_deg": 50},
    )
    assert (clearance.turn[3, 0], clearance.heading_deg[3, 0]) == (SHORTEST, 50.0)
    assert (clearance.changes_level[3, 0], clearance.level[3, 0]) == (True, ticks(320.0))


def test_the_rows_are_complete_and_sorted_by_cycle(tmp_path):
    scenario = load(MINIMAL, tmp_path)
    columns = rows(scenario, fly(scenario))
    assert {len(column) for column in columns.values()} == {26}
    assert columns["callsign"].tolist() == ["AC1", "AC2"] * 13
    assert columns["cycle"].tolist() == [cycle for cycle in range(13) for _ in range(2)]
    assert columns["time_s"].tolist() == [6 * cycle for cycle in columns["cycle"].tolist()]
    # Row 0 is the start: where and how the file says.
    np.testing.assert_allclose(columns["lat"][:2], [-0.41, 0.7], atol=1e-6)
    np.testing.assert_allclose(columns["lon"][:2], [-0.41, 0.7], atol=1e-6)
    np.testing.assert_allclose(columns["heading_deg"][:2], [45.1920, 225.1904], atol=1e-4)
    assert columns["fl"][:2].tolist() == columns["cleared_fl"][:2].tolist() == [300.0, 300.0]
    np.testing.assert_allclose(columns["ground_speed_kt"][:2], 465.9408, atol=1e-3)
    assert columns["vertical_speed_ft_min"][:2].tolist() == [0.0, 0.0]


def test_a_clearance_shows_in_the_next_row_and_is_flown_in_the_one_after(tmp_path):
    one = {"cycle": 3, "callsign": "AC1", "heading_deg": 60, "fl": 310}
    columns = flown(load(changed(C0, one), tmp_path))
    start_deg = columns["heading_deg"][0, 0]
    assert columns["cleared_heading_deg"][:5, 0].tolist() == [start_deg] * 4 + [60.0]
    assert columns["cleared_fl"][:5, 0].tolist() == [300.0] * 4 + [310.0]
    np.testing.assert_allclose(
        columns["heading_deg"][:7, 0], [start_deg] * 5 + [start_deg + 9, 60.0], atol=1e-4
    )
    assert columns["fl"][:7, 0].tolist() == [300.0] * 5 + [302.5, 305.0]
    # The other aircraft was told nothing.
    assert set(columns["cleared_fl"][:, 1]) == {300.0}
    assert set(columns["heading_deg"][:, 1]) == {columns["heading_deg"][0, 1]}


def reference_a(performance, tmp_path):
    scenario = json.loads((EXAMPLES / "reference.json").read_text())
    return flown(load(scenario | {"performance": performance}, tmp_path))


def off_nm(columns, aircraft, lat, lon):
    """Distance of the last position from BluebirdDT's."""
    return geodesic_leg((columns["lat"][-1, aircraft], columns["lon"][-1, aircraft]), (lat, lon))[1]


def test_the_reference_starts_three_miles_from_its_fix():
    scenario = load_scenario(EXAMPLES / "reference.json", SECTORS)
    second = scenario.aircraft[1]
    bearing, distance = geodesic_leg(scenario.sector.fixes["PEL"], (second.lat, second.lon))
    assert bearing == pytest.approx(200.0, abs=1e-4)
    assert distance == pytest.approx(3.0, abs=1e-6)


def test_the_reference_rollout_agrees_with_bluebird_at_constant_speed(tmp_path):
    columns = reference_a("constant", tmp_path)
    first, second = columns["heading_deg"].T
    np.testing.assert_allclose(first[[5, 6, 7, 8]], [45.1920, 45.1920, 36.1920, 35.0], atol=1e-4)
    np.testing.assert_allclose(first[[41, 42, 43, 50, 60]], [45.0, 54.0, 63.0, 126.0, 205.0])
    np.testing.assert_allclose(second[[4, 5, 6, 7]], [134.80895, 125.80895, 116.80895, 115.0])
    assert (first[300], second[300]) == (205.0, 45.0)
    assert off_nm(columns, 0, -2.591542109, -1.130081790) < TANGENT_PLANE_NM
    assert off_nm(columns, 1, 1.632091695, 1.918770306) < TANGENT_PLANE_NM


def test_the_reference_rollout_agrees_with_bluebird_on_the_table(tmp_path):
    columns = reference_a("table", tmp_path)
    assert off_nm(columns, 0, -2.950759395, -1.248507504) < TANGENT_PLANE_NM
    assert off_nm(columns, 1, 1.802074, 2.344787) < TANGENT_PLANE_NM


def test_the_climb_agrees_with_bluebird():
    columns = flown(load_scenario(EXAMPLES / "climb.json", SECTORS))
    assert columns["cleared_fl"][[2, 3], 0].tolist() == [100.0, 300.0]
    assert columns["fl"][[3, 4, 83], 0].tolist() == [100.0, 102.5, 300.0]
    assert columns["fl"][82, 0] < 300.0
    # Ground speed at the top of the climb and in level flight after it.
    np.testing.assert_allclose(
        columns["ground_speed_kt"][[83, 84], 0], [450.741, 465.941], atol=0.01
    )
    # Own navigation keeps to the straight route and leaves through its arm.
    np.testing.assert_allclose(columns["heading_deg"][:, 0], 45.19, atol=0.01)


def test_the_head_on_pair_keeps_apart():
    scenario = load_scenario(EXAMPLES / "head-on.json", SECTORS)
    columns = flown(scenario)
    east, north = scenario.sector.plane.to_plane(columns["lat"], columns["lon"]).T
    apart_nm = np.hypot(east[0] - east[1], north[0] - north[1])
    assert apart_nm.min() > 5.0
    assert apart_nm[0] > 95.0
    # Each ends beyond the other's start.
    assert (east[0, -1], north[0, -1]) > (east[1, 0], north[1, 0])
    assert (east[1, -1], north[1, -1]) < (east[0, 0], north[0, 0])


@given(st.integers(0, 360), st.sampled_from(["shortest", "left", "right"]))
def test_every_whole_heading_is_cleared_as_it_is(tmp_path_factory, heading_deg, turn):
    path = tmp_path_factory.getbasetemp() / "heading.json"
    one = {"cycle": 0, "callsign": "AC2", "heading_deg": heading_deg, "turn": turn}
    path.write_text(json.dumps(changed(C0, one)))
    clearance = load_scenario(path, SECTORS).clearances_by_cycle()
    assert clearance.heading_deg[0, 1] == heading_deg % 360
    assert clearance.turn[0, 1] == {"shortest": SHORTEST, "left": LEFT, "right": RIGHT}[turn]
