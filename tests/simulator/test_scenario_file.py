"""Scenario files: refused files and their messages, and the contents of valid files."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.io.json_file import MAX_BYTES
from skystack.simulator.scenario_file import ScheduledClearance, load_scenario
from tests.scenarios import MINIMAL, changed, load

A1, C0 = ("aircraft", 1), ("clearances", 0)
ONE_AIRCRAFT = MINIMAL["aircraft"][0]
REFUSED = [
    # Fields and types.
    (("levels",), 1, "unknown field 'levels'; did you mean 'levels_fl'? (allowed: aircraft, "),
    ((*A1, "callsing"), 1, "aircraft[1]: unknown field 'callsing'; did you mean 'callsign'? ("),
    ((*A1, "\ud800"), 1, 'a field name in aircraft[1] is "\\ud800" (allowed: printable'),
    (("a\nb - at `$.x`",), 1, "unknown field 'a\\nb - at `$.x`' (allowed: aircraft, clearanc"),
    ((*C0, "turns"), 1, "clearances[0]: unknown field 'turns'; did you mean 'turn'? (allowed: "),
    (("sector",), ..., "sector is missing"),
    ((*A1, "route"), ..., "aircraft[1].route is missing"),
    ((*C0, "callsign"), ..., "clearances[0].callsign is missing"),
    (("aircraft",), "AC1", 'aircraft is "AC1" (allowed: list of 1 to 200)'),
    (("aircraft",), ["AC1"], 'aircraft[0] is "AC1" (allowed: object)'),
    ((*A1, "fl"), "high", 'aircraft[1].fl is "high" (allowed: number)'),
    ((*A1, "fl"), True, "aircraft[1].fl is true (allowed: number)"),
    ((*A1, "own_navigation"), 1, "aircraft[1].own_navigation is 1 (allowed: true or false)"),
    (
        (*C0, "heading_deg"),
        35.5,
        "clearances[0].heading_deg is 35.5 (allowed: whole number from 0 to 360)",
    ),
    # Sector, performance, routes and callsigns.
    (
        ("sector",),
        "xplus",
        "sector: unknown sector 'xplus'; did you mean 'x-plus'? (allowed: crossing, ",
    ),
    (("performance",), "tabel", "performance: unknown performance model 'tabel'; did you mean 't"),
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
    ((*A1, "route"), ["EGL"], 'aircraft[1].route is ["EGL"] (allowed: list of at least 2)'),
    (
        (*A1, "callsign"),
        "AC1",
        'aircraft[1].callsign is "AC1" (allowed: a unique callsign; aircraft[0] has this one)',
    ),
    ((*A1, "callsign"), "", 'aircraft[1].callsign is "" (allowed: printable characters, with'),
    ((*A1, "callsign"), " ", 'aircraft[1].callsign is " " (allowed: printable characters, wit'),
    ((*A1, "callsign"), "A\nB", 'aircraft[1].callsign is "A\\nB" (allowed: printable characters'),
    ((*A1, "callsign"), "\ud800", 'aircraft[1].callsign is "\\ud800" (allowed: printable charac'),
    (("aircraft",), [], "aircraft is [] (allowed: list of 1 to 200)"),
    (("aircraft",), [ONE_AIRCRAFT] * 201, 'aircraft is [{"callsign": "AC1", "route": ["HERON", "'),
    # Positions, headings and levels.
    ((*A1, "lat"), 91, "aircraft[1].lat is 91 (allowed: number from -90 to 90)"),
    ((*A1, "lon"), -181, "aircraft[1].lon is -181 (allowed: number from -180 to 180)"),
    (
        (*A1, "lat"),
        7.0,
        "aircraft[1] is 420 NM from the origin of x-plus at lat 7.0, lon 0.7 "
        "(allowed: at most 400 NM)",
    ),
    (
        (*A1, "heading_deg"),
        360.5,
        "aircraft[1].heading_deg is 360.5 (allowed: number from 0 to 360)",
    ),
    (("levels_fl",), [300, 200], "levels_fl is [300, 200] (allowed: the lowest level, then a hi"),
    (
        ("levels_fl",),
        [200, 305],
        "levels_fl[1] is 305 (allowed: whole number from 0 to 600, a multiple of 10)",
    ),
    (("levels_fl",), [200, 610], "levels_fl[1] is 610 (allowed: whole number from 0 to 600, a"),
    (("levels_fl",), [200], "levels_fl is [200] (allowed: list of 2)"),
    ((*A1, "fl"), 400.5, "aircraft[1].fl is 400.5 (allowed: 200 to 400)"),
    ((*A1, "exit_fl"), 305, "aircraft[1].exit_fl is 305 (allowed: multiples of 10 from 200 to 40"),
    ((*A1, "exit_fl"), 410, "aircraft[1].exit_fl is 410 (allowed: multiples of 10 from 200 to 40"),
    ((*A1, "fl"), 300.5, "aircraft[1].exit_fl (the default is fl) is 300.5 (allowed: multiples "),
    # Clearances.
    (("cycles",), 0, "cycles is 0 (allowed: whole number from 1 to 10,000)"),
    (("cycles",), 10_001, "cycles is 10001 (allowed: whole number from 1 to 10,000)"),
    ((*C0, "callsign"), "AC3", "clearances[0].callsign: unknown callsign 'AC3'; did you mean 'A"),
    ((*C0, "cycle"), 12, "clearances[0].cycle is 12 (allowed: 0 to 11, which is cycles - 1)"),
    ((*C0, "cycle"), -1, "clearances[0].cycle is -1 (allowed: 0 to 11, which is cycles - 1)"),
    (
        (*C0, "heading_deg"),
        ...,
        "clearances[0] has no heading, fix or level (allowed: heading_deg or direct_to, with or wi",
    ),
    (
        (*C0, "heading_deg"),
        361,
        "clearances[0].heading_deg is 361 (allowed: whole number from 0 to 360)",
    ),
    ((*C0, "fl"), 335, "clearances[0].fl is 335 (allowed: multiples of 10 from 200 to 400)"),
    ((*C0, "fl"), 10**30, "clearances[0].fl is 1000000000000000000000000000000 (allowed: multip"),
    ((*C0, "turn"), "lefft", "clearances[0].turn: unknown turn 'lefft'; did you mean 'left'? (all"),
    (
        ("clearances", 0),
        {"cycle": 3, "callsign": "AC1", "fl": 310, "turn": "left"},
        'clearances[0].turn is "left" (allowed: only together with heading_deg)',
    ),
    (
        (*C0, "direct_to"),
        "EGL",
        'clearances[0].direct_to is "EGL" (allowed: only without heading_deg)',
    ),
    (
        ("clearances", 0),
        {"cycle": 3, "callsign": "AC1", "direct_to": "EGLE"},
        "clearances[0].direct_to: unknown fix of the route 'EGLE'; did you mean 'EGL'? (allowed: ",
    ),
    (
        ("clearances", 0),
        {"cycle": 3, "callsign": "AC1", "direct_to": "GOOSE"},  # of another route
        "clearances[0].direct_to: unknown fix of the route 'GOOSE' (allowed: ",
    ),
    (
        ("clearances", 0),
        {"cycle": 3, "callsign": "AC1", "direct_to": "HERON"},  # where the route starts
        "clearances[0].direct_to: unknown fix of the route 'HERON' (allowed: ",
    ),
]


@pytest.mark.parametrize(("where", "value", "message"), REFUSED)
def test_refuses_a_bad_value_in_one_line(where, value, message, tmp_path):
    with pytest.raises(InputError) as error:
        load(changed(where, value), tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'scenario.json'}: {message}")
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty (allowed: JSON)"),
        (b'{"sector": }', "is not JSON (Expecting value: line 1 column 12 (char 11))"),
        (b"[1]", "the file is [1] (allowed: object)"),
        (b"[" * 100_000, "is nested too deep (allowed: 32 levels)"),
        (b'{"sector": "\xff"}', "is not UTF-8 (byte 12)"),
        (b'{"cycles": NaN}', "NaN is not a JSON number (allowed: finite numbers)"),
        (
            b'{"cycles": 1, "cycles": 2}',
            "field 'cycles' appears twice in one object (allowed: once)",
        ),
        (
            b'{"cycles": 1' + b"0" * 5000 + b"}",
            "has a whole number with too many digits",
        ),
        (b" " * (MAX_BYTES + 1), "is too large (allowed: 10 MB)"),
    ],
)
def test_refuses_a_file_that_is_not_a_scenario(data, message, tmp_path):
    path = tmp_path / "scenario.json"
    path.write_bytes(data)
    with pytest.raises(InputError) as error:
        load_scenario(path)
    assert str(error.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize(
    ("number", "message"),
    [
        ("1e999", "aircraft[1].fl is Infinity (allowed: finite number)"),
        ("1" + "0" * 400, f"aircraft[1].fl is 1{'0' * 59}... (allowed: finite number)"),
    ],
)
def test_refuses_a_number_too_large_for_a_float(number, message, tmp_path):
    text = json.dumps(changed((*A1, "fl"), "NUMBER")).replace('"NUMBER"', number)
    with pytest.raises(InputError) as error:
        load(text, tmp_path)
    assert str(error.value) == f"{tmp_path / 'scenario.json'}: {message}"


def test_refuses_a_path_that_cannot_be_read(tmp_path):
    for path, reason in [(tmp_path / "no.json", "No such file"), (tmp_path, "Is a directory")]:
        with pytest.raises(InputError) as error:
            load_scenario(path)
        assert str(error.value).startswith(f"{path}: cannot be read ({reason}")


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
def test_accepts_or_refuses_any_value_in_one_line(tmp_path_factory, where, value):
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_text(json.dumps(changed(where, value)))
    try:
        scenario = load_scenario(path)
    except InputError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017
    else:
        low, high = scenario.sector.levels_fl
        assert all(low <= aircraft.fl <= high for aircraft in scenario.aircraft)
        assert all(0 <= each.cycle < scenario.cycles for each in scenario.clearances)


def test_missing_fields_have_the_documented_defaults(tmp_path):
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


def test_keeps_the_values_of_the_file(tmp_path):
    values = {"type": "B753", "heading_deg": 360.0, "exit_fl": 250, "own_navigation": True}
    scenario = load(changed(A1, MINIMAL["aircraft"][1] | values), tmp_path)
    aircraft = scenario.aircraft[1]
    assert (aircraft.lat, aircraft.lon, aircraft.fl) == (0.7, 0.7, 300)
    assert (aircraft.heading_deg, aircraft.exit_fl, aircraft.own_navigation) == (0.0, 250, True)
    assert scenario.simulator().own_navigation
    assert not load(MINIMAL, tmp_path).simulator().own_navigation
    assert load(changed(("levels_fl",), [250, 350]), tmp_path).sector.levels_fl == (250, 350)


def test_accepts_a_byte_order_mark(tmp_path):
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(MINIMAL), encoding="utf-8-sig")
    assert load_scenario(path).cycles == 12


def transmissions_of(tmp_path, *entries):
    """The transmissions of the minimal scenario with these entries of `clearances`."""
    return load(changed(("clearances",), list(entries)), tmp_path).transmissions()


def test_transmissions_are_grouped_by_cycle(tmp_path):
    transmissions = transmissions_of(
        tmp_path,
        {"cycle": 3, "callsign": "AC2", "heading_deg": 360, "turn": "left", "fl": 340},
        {"cycle": 0, "callsign": "AC1", "fl": 200},
        {"cycle": 11, "callsign": "AC1", "heading_deg": 90},
        {"cycle": 3, "callsign": "AC1", "fl": 310},
    )
    assert transmissions == {
        0: [ScheduledClearance(0, "AC1", None, None, 200)],
        3: [
            ScheduledClearance(3, "AC2", 360, "left", 340),
            ScheduledClearance(3, "AC1", None, None, 310),
        ],
        11: [ScheduledClearance(11, "AC1", 90)],
    }
    assert list(transmissions) == [0, 3, 11]


def test_later_entries_of_a_cycle_replace_only_their_own_fields(tmp_path):
    transmissions = transmissions_of(
        tmp_path,
        {"cycle": 3, "callsign": "AC1", "heading_deg": 35, "turn": "right"},
        {"cycle": 3, "callsign": "AC1", "fl": 310},
        {"cycle": 3, "callsign": "AC1", "heading_deg": 40, "turn": "right"},
        {"cycle": 3, "callsign": "AC1", "fl": 320},
        {"cycle": 3, "callsign": "AC1", "heading_deg": 50},
        {"cycle": 4, "callsign": "AC1", "heading_deg": 60, "turn": "left"},
        {"cycle": 4, "callsign": "AC1", "fl": 330},
    )
    assert transmissions == {
        3: [ScheduledClearance(3, "AC1", 50, None, 320)],
        4: [ScheduledClearance(4, "AC1", 60, "left", 330)],
    }


@given(st.integers(0, 360), st.sampled_from(["shortest", "left", "right"]))
def test_clears_every_whole_heading_unchanged(tmp_path_factory, heading_deg, turn):
    path = tmp_path_factory.getbasetemp() / "heading.json"
    entry = {"cycle": 0, "callsign": "AC2", "heading_deg": heading_deg, "turn": turn}
    path.write_text(json.dumps(changed(C0, entry)))
    transmissions = load_scenario(path).transmissions()
    assert transmissions == {0: [ScheduledClearance(0, "AC2", heading_deg, turn)]}


def test_refuses_deep_nesting(tmp_path):
    path = tmp_path / "scenario.json"
    path.write_text('{"aircraft": ' + "[" * 900 + "]" * 900 + "}")
    with pytest.raises(InputError, match=r"nested too deep \(allowed: 32 levels\)"):
        load_scenario(path)


@pytest.mark.parametrize(("count", "cycles"), [(200, 2500), (50, 10_000)])
def test_limits_the_product_of_aircraft_and_cycles(count, cycles, tmp_path):
    crowd = [ONE_AIRCRAFT | {"callsign": f"AC{number}"} for number in range(count)]
    largest = MINIMAL | {"aircraft": crowd, "cycles": cycles, "clearances": []}
    assert len(load(largest, tmp_path).aircraft) == count
    one_more = largest | {"aircraft": [*crowd, ONE_AIRCRAFT | {"callsign": "MORE"}]}
    too_large = largest | {"cycles": cycles + 1} if cycles < 10_000 else one_more
    with pytest.raises(InputError, match=r"positions \(allowed: 500,000, which is"):
        load(too_large, tmp_path)


@pytest.mark.slow
def test_limits_the_number_of_clearances(tmp_path):
    entries = [{"cycle": 0, "callsign": "AC1", "heading_deg": 10}] * 10_001
    with pytest.raises(InputError, match=r"clearances is .*allowed: list of at most 10,000"):
        load(MINIMAL | {"clearances": entries}, tmp_path)
    assert len(load(MINIMAL | {"clearances": entries[1:]}, tmp_path).clearances) == 10_000
