"""Types of a fleet fly at their own speeds and rates on every platform, or are rejected."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from skystack.airspace.projection import WGS84
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.platforms.bluesky_scenario import scenario_text
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from skystack.platforms.registry import open_platform, scenario_notes
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import tas_from_cas, tas_from_mach
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance
from tests.scenarios import MINIMAL, changed, load

SECTOR = replace(x_plus(), levels_fl=(50, 400))
AT76 = AircraftType(
    "AT76",
    low_cas_kt=(160.0, 170.0, 180.0),
    high_cas_kt=(160.0, 170.0, 180.0),
    mach=(0.40, 0.44, 0.42),
    rate_ft_min=1200.0,
)
A320 = AircraftType("A320", 1.0, (210.0, 220.0, 200.0), (250.0, 260.0, 240.0), rate_ft_min=1800.0)
FLEET = (AircraftType(), AT76, A320)
STARTS = {"A": ("B753", 120.0), "B": ("AT76", 180.0), "C": ("AT76", 280.0), "D": ("A320", 300.9)}
CLIMBS = ((3, "A", 340), (4, "B", 130), (30, "D", 120), (90, "B", 240), (150, "A", 60))


def scenario(flying=STARTS, levels=(), fleet=FLEET, cycles=300):
    aircraft = tuple(
        Aircraft(callsign, kind, SECTOR.routes[0], -0.2, 0.1, fl, 45.0 + 30.0 * place, 300, False)
        for place, (callsign, (kind, fl)) in enumerate(flying.items())
    )
    turns = tuple(ScheduledClearance(20 * place, one, 100) for place, one in enumerate(flying))
    climbs = tuple(ScheduledClearance(cycle, callsign, fl=fl) for cycle, callsign, fl in levels)
    return Scenario(SECTOR, "table", cycles, aircraft, turns + climbs, fleet)


def fly(name, flown, folder):
    if name != "skystack":
        pytest.importorskip({"bluebird": "bluebird_dt"}.get(name, name))
    platform = open_platform(name, folder)
    try:
        return np.array(fly_scenario(platform, flown).reports)
    finally:
        platform.close()


def cruise_kt(kind, fl):
    """The true airspeed, by the formulas of the standard atmosphere."""
    level = np.array([fl])
    cas = np.interp(fl, [100.0, 150.0], [kind.low_cas_kt[1], kind.high_cas_kt[1]])
    return min(tas_from_cas(level, np.array([cas])), tas_from_mach(level, kind.mach[1])).item()


@pytest.mark.parametrize("name", ["skystack", "bluebird", "bluesky"])
def test_each_type_cruises_at_its_own_speed(name, tmp_path):
    flown = scenario(cycles=10)
    speeds = fly(name, flown, tmp_path)[:, 6]
    kinds = {each.type: each for each in FLEET}
    expected = [cruise_kt(kinds[kind], fl) for kind, fl in STARTS.values()]
    np.testing.assert_allclose(speeds, np.tile(expected, (11, 1)), rtol=2e-4)
    assert expected[2] == pytest.approx(261.5, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("levels", "within_fl"), [((), 0.0), (CLIMBS, 1e-9)])
def test_bluebird_flies_a_fleet_like_skystack(levels, within_fl, tmp_path):
    flown = scenario(levels=levels)
    ours, theirs = (fly(name, flown, tmp_path) for name in ("skystack", "bluebird"))
    place = [ours[:, 1], ours[:, 0], theirs[:, 1], theirs[:, 0]]
    _, _, apart_m = WGS84.inv(*(values.reshape(-1) for values in place))
    assert apart_m.max() / 1852.0 < 0.02
    assert np.abs(ours[:, 2] - theirs[:, 2]).max() <= within_fl
    np.testing.assert_allclose(ours[:, 6], theirs[:, 6], atol=0.01)


def test_bluesky_climbs_at_the_rate_and_speed_of_the_type(tmp_path):
    flown = scenario(levels=CLIMBS, cycles=70)
    ours, theirs = (fly(name, flown, tmp_path) for name in ("skystack", "bluesky"))
    # AT76 "B" descends from cycle 4 on, by 50 levels at 1,200 ft/min; "A" climbs at 2,500.
    np.testing.assert_allclose(theirs[20, 7], ours[20, 7], atol=1e-6)
    assert theirs[20, 7, :2].tolist() == pytest.approx([2500.0, -1200.0])
    # One minute after the last clearance, BlueSky has reached its new speeds.
    np.testing.assert_allclose(theirs[40:, 6], ours[40:, 6], rtol=0.01)
    assert theirs[-1, 2, 1] == ours[-1, 2, 1] == 130.0


def test_bluesky_file_has_the_speeds_of_the_type():
    text = scenario_text(scenario(cycles=10))
    assert re.search(r"CRE B AT76 \S+ \S+ \S+ 18000\S* 170\.000000\n", text)
    assert re.search(r"CRE C AT76 \S+ \S+ \S+ 28000\S* M0\.44000000\n", text)
    climb = scenario_text(scenario(levels=CLIMBS))
    assert "00:00:24.00>VS B 1200.000000" in climb
    assert "00:00:24.00>SPD B 180.000000" in climb


@pytest.mark.parametrize(
    ("member", "message"),
    [
        (
            {"high_cas_kt": (390.0,) * 3, "mach": (0.9, 0.9, 0.9)},
            "A flies .* M0.90, at FL300 .*up to M0.79",
        ),
        ({"high_cas_kt": (100.0, 100.0, 100.0)}, "A flies 100 kt CAS.*124 to 309 kt"),
    ],
)
def test_rejects_speeds_outside_the_envelope_of_bluesky(member, message, tmp_path):
    fast = {"high_cas_kt": (300.0, 300.0, 300.0), "mach": (0.44, 0.44, 0.44)}
    kind = msgspec.structs.replace(AT76, **fast | member)
    with pytest.raises(InputError, match=message):
        fly("bluesky", scenario({"A": ("AT76", 300.0)}, fleet=(kind,), cycles=2), tmp_path)


@pytest.mark.parametrize(
    ("member", "message"),
    [
        ({"rate_ft_min": 8000.0}, "rate_ft_min is 8000 for A .*up to 3272"),
        ({"ceiling_fl": 250.0}, "fl is 260 for A .*up to FL250, the ceiling of AT76"),
    ],
)
def test_rejects_climbs_that_bluesky_cannot_fly(member, message, tmp_path):
    kind = msgspec.structs.replace(AT76, **member)
    flown = scenario({"A": ("AT76", 200.0)}, ((0, "A", 260),), fleet=(kind,), cycles=2)
    with pytest.raises(InputError, match=message):
        fly("bluesky", flown, tmp_path)


@pytest.mark.parametrize("name", ["skystack", "bluebird", "bluesky"])
def test_flies_fractional_levels_exactly(name, tmp_path):
    flown = scenario({"A": ("B753", 300.9), "B": ("B753", 305.0)}, fleet=(), cycles=3)
    levels = fly(name, flown, tmp_path)[:, [2, 5]]
    np.testing.assert_allclose(levels[:, 0], np.tile([300.9, 305.0], (4, 1)), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(levels[:, 1], levels[:, 0], rtol=0.0, atol=1e-9)


MEMBER = {"type": "AT76", "low_cas_kt": [160, 170, 180.0], "mach": [0.4, 0.44, 0.42]}


def with_fleet(members, **fields):
    file = changed(("fleet",), members) | fields
    for one in file["aircraft"]:
        one["type"] = "AT76"
    return file


def test_scenario_file_may_define_a_fleet(tmp_path):
    flown = load(with_fleet([MEMBER]), tmp_path)
    assert flown.performance_of("AT76").low_cas_kt == (160.0, 170.0, 180.0)
    reports = fly_scenario(Skystack(), flown).reports
    kind = msgspec.convert(MEMBER, AircraftType)
    np.testing.assert_allclose(reports[-1].ground_speed_kt, cruise_kt(kind, 300.0), rtol=1e-5)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (with_fleet([MEMBER, MEMBER]), "fleet[1].type is AT76 (allowed: every type once)"),
        (
            with_fleet([MEMBER], performance="constant"),
            'performance is "constant" (allowed: "table"',
        ),
        (with_fleet([MEMBER | {"mach": [2, 2, 2]}]), "fleet[0].mach[0] is 2"),
        (
            changed(("fleet",), [MEMBER]),
            'aircraft[0].type is "B753" (allowed: the types of the fleet: AT76)',
        ),
    ],
)
def test_rejects_invalid_fleets(file, message, tmp_path):
    with pytest.raises(InputError, match=re.escape(message)):
        load(file, tmp_path)


def test_notes_how_types_outside_the_fleet_are_flown(tmp_path):
    file = changed(("aircraft", 1, "type"), "B744", MINIMAL)
    flown = load(file, tmp_path)
    assert scenario_notes("bluebird", flown) == [
        "bluebird flies B744 at the speeds of its own tables"
    ]
    assert scenario_notes("bluesky", flown)[1:] == ["bluesky flies B744 at the speeds of B753"]


def test_exit_levels_are_whole_numbers(tmp_path):
    file = changed(("aircraft", 0, "exit_fl"), 220.0)
    assert load(file, tmp_path).aircraft[0].exit_fl == 220
    with pytest.raises(InputError, match=re.escape("aircraft[0].exit_fl is 220.5 (allowed: whole")):
        load(changed(("aircraft", 0, "exit_fl"), 220.5), tmp_path)


def test_rejects_a_type_and_its_substitute_in_one_fleet(tmp_path):
    both = (AircraftType(), AircraftType("B752"))
    flown = scenario({"A": ("B753", 300.0)}, fleet=both, cycles=2)
    with pytest.raises(InputError, match="the fleet has B753, which BlueSky flies as B752, and"):
        fly("bluesky", flown, tmp_path)


@pytest.mark.parametrize("name", ["skystack", "bluebird"])
def test_no_aircraft_climbs_above_its_ceiling(name, tmp_path):
    """An aircraft cleared above its ceiling stops there; the other type climbs on. At the ceiling
    an aircraft stays level, and above it, it descends as cleared."""
    low = msgspec.structs.replace(AT76, ceiling_fl=200.0)
    levels = {"A": 190.0, "B": 200.0, "C": 210.0}
    flying = {callsign: ("AT76", fl) for callsign, fl in levels.items()} | {"D": ("A320", 190.0)}
    clearances = ((0, "A", 220), (0, "B", 220), (0, "C", 150), (0, "D", 220))
    flown = scenario(flying, clearances, fleet=(low, A320), cycles=40)
    reports = fly(name, flown, tmp_path)
    # 1,200 ft/min is 0.2 levels per second, so the ceiling is reached exactly.
    np.testing.assert_allclose(reports[-1, 2, [0, 1, 3]], [200.0, 200.0, 220.0], atol=1e-6)
    np.testing.assert_allclose(reports[-1, 2, 2], 210.0 - 39 * 6 * 0.2, atol=1e-6)
    assert reports[-1, 7].tolist() == [0.0, 0.0, -1200.0, 0.0]
