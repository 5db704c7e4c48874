"""BlueSky behind the platform protocol: flights, rejected input, no side effects."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

bluesky = pytest.importorskip("bluesky")

from skystack.airspace.sector import turns_deg  # noqa: E402
from skystack.airspace.xplus import x_plus  # noqa: E402
from skystack.errors import InputError, PlatformError  # noqa: E402
from skystack.evaluation.evaluate import Conditions, evaluate  # noqa: E402
from skystack.evaluation.summary import evaluation_folder  # noqa: E402
from skystack.export.scenario import export_scenario  # noqa: E402
from skystack.platforms.bluesky import BlueSky  # noqa: E402
from skystack.platforms.bluesky_scenario import TYPES, levels_fl, scenario_text  # noqa: E402
from skystack.platforms.flight import fly_scenario  # noqa: E402
from skystack.platforms.instruction import Instruction  # noqa: E402
from skystack.platforms.protocol import Platform, Report  # noqa: E402
from skystack.policies.shipped import find_policy  # noqa: E402
from skystack.simulator.fleet import AircraftType  # noqa: E402
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance  # noqa: E402

SECTOR = x_plus()
BENT = max(SECTOR.routes, key=lambda route: abs(SECTOR.first_heading_deg(route) % 90.0 - 45.0))
G_M_S2, BANK_DEG, KT_M_S = 9.80665, 25.0, 1852.0 / 3600.0


def aircraft(callsign="AC1", *, route=BENT, lat=-0.2, lon=0.1, fl=300.0, heading_deg=45.0, **other):
    """An aircraft inside the sector, without own navigation unless requested."""
    one = Aircraft(callsign, "B753", route, lat, lon, fl, heading_deg, 300, False)
    return replace(one, **other)


def navigating(callsign, route, fl=300.0):
    """An aircraft on own navigation, at the first fix of its route."""
    lat, lon = SECTOR.fixes[route[0]]
    heading = SECTOR.first_heading_deg(route)
    return aircraft(
        callsign, route=route, lat=lat, lon=lon, fl=fl, heading_deg=heading, own_navigation=True
    )


def scenario(*flying, clearances=(), cycles=60, performance="table"):
    sector = replace(SECTOR, levels_fl=(100, 600))
    return Scenario(sector, performance, cycles, flying or (aircraft(),), clearances)


INSTRUCTED = scenario(
    aircraft("AC1"),
    aircraft("AC2", lat=0.3, lon=-0.2, fl=200.0, heading_deg=181.234),
    clearances=(
        ScheduledClearance(0, "AC2", heading_deg=10),
        ScheduledClearance(7, "AC1", heading_deg=300, fl=340),
        ScheduledClearance(20, "AC2", fl=120),
        ScheduledClearance(31, "AC1", fl=280),
        ScheduledClearance(31, "AC2", heading_deg=359, fl=330),
    ),
)
NAVIGATING = scenario(
    navigating("AC1", SECTOR.routes[0]),
    navigating("AC2", SECTOR.routes[-1], fl=250.0),
    clearances=(ScheduledClearance(40, "AC2", heading_deg=90, fl=270),),
    cycles=150,
)


def fly(platform, flown):
    """All reports of a scenario flown with its clearances: an array [cycle, column, aircraft]."""
    return np.array(fly_scenario(platform, flown).reports)


def column(reports, name):
    return reports[:, Report._fields.index(name)]


@pytest.fixture
def platform(tmp_path):
    opened = BlueSky(tmp_path)
    yield opened
    opened.close()


@pytest.mark.slow
def test_implements_the_protocol(platform):
    assert isinstance(platform, Platform)
    report = platform.reset(INSTRUCTED)
    assert all(values.dtype == np.float64 and values.shape == (2,) for values in report)


def test_starts_with_the_given_state(platform):
    report = platform.reset(INSTRUCTED)
    for name, expected in (
        ("lat", [-0.2, 0.3]),
        ("lon", [0.1, -0.2]),
        ("fl", [300.0, 200.0]),
        ("heading_deg", [45.0, 181.234]),
        ("cleared_heading_deg", [45.0, 181.234]),
        ("cleared_fl", [300.0, 200.0]),
        ("vertical_speed_ft_min", [0.0, 0.0]),
    ):
        np.testing.assert_allclose(getattr(report, name), expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(("name", "fl"), [("table", 300), ("table", 360), ("constant", 250)])
def test_holds_the_cruise_speed_of_the_performance_model(platform, name, fl):
    flown = scenario(aircraft(fl=float(fl)), performance=name, cycles=20)
    speed = column(fly(platform, flown), "ground_speed_kt")
    simulator = flown.simulator()
    cruise = simulator.level_ground_speed_kt(flown.initial_traffic(simulator).level_ticks)
    # The constants of the two atmospheres differ in the fifth digit.
    np.testing.assert_allclose(speed, np.full_like(speed, cruise), rtol=2e-4)


def test_cruise_speed_follows_the_cleared_level(platform):
    clearances = (ScheduledClearance(0, "AC1", fl=360),)
    speed = column(fly(platform, scenario(clearances=clearances)), "ground_speed_kt")
    assert speed[-1, 0] == pytest.approx(0.8 * 573.6, rel=2e-3)


def test_straight_flight_matches_the_ground_speed(platform):
    reports = fly(platform, scenario(cycles=30))
    lat, lon = column(reports, "lat")[:, 0], column(reports, "lon")[:, 0]
    earth_m = 6371000.0
    flown_m = np.radians(np.hypot(lat[-1] - lat[0], lon[-1] - lon[0])) * earth_m
    speed_m_s = column(reports, "ground_speed_kt")[0, 0] * KT_M_S
    assert flown_m == pytest.approx(30 * 6 * speed_m_s, rel=1e-4)


def test_turns_are_coordinated_and_begin_at_once(platform):
    first = platform.reset(scenario())
    platform.issue(Instruction("AC1", heading_deg=135))
    second = platform.advance()
    speed_m_s = first.ground_speed_kt[0] * KT_M_S
    rate_deg_s = np.degrees(G_M_S2 * np.tan(np.radians(BANK_DEG)) / speed_m_s)
    assert second.heading_deg[0] == pytest.approx(45.0 + 6 * rate_deg_s, abs=1e-3)
    assert second.cleared_heading_deg[0] == 135.0


@pytest.mark.parametrize("heading", [0, 35, 215, 359, 360])
def test_captures_headings_exactly_the_shorter_way(platform, heading):
    clearances = (ScheduledClearance(0, "AC1", heading_deg=heading),)
    headings = column(fly(platform, scenario(clearances=clearances, cycles=40)), "heading_deg")[
        :, 0
    ]
    assert headings[-1] == heading % 360
    turned = np.abs((np.diff(headings) + 180.0) % 360.0 - 180.0).sum()
    assert turned == pytest.approx(abs((heading - 45.0 + 180.0) % 360.0 - 180.0), abs=1e-9)


@pytest.mark.parametrize("level", [340, 290, 180])
def test_captures_levels_exactly(platform, level):
    clearances = (ScheduledClearance(0, "AC1", fl=level),)
    reports = fly(platform, scenario(clearances=clearances, cycles=100))
    assert column(reports, "fl")[-1, 0] == level
    assert column(reports, "cleared_fl")[1, 0] == level
    assert column(reports, "vertical_speed_ft_min")[-1, 0] == 0.0
    rate = column(reports, "vertical_speed_ft_min")[3, 0]
    assert rate == pytest.approx(2500.0 if level > 300 else -2500.0)


def test_obeys_heading_and_level_of_one_instruction(platform):
    platform.reset(scenario())
    platform.issue(Instruction("AC1", heading_deg=100, level_fl=320))
    report = platform.advance()
    assert (report.cleared_heading_deg[0], report.cleared_fl[0]) == (100.0, 320.0)
    assert report.fl[0] > 300.0
    assert report.heading_deg[0] > 45.0


@pytest.mark.slow
def test_own_navigation_cuts_corners_in_coordinated_turns(platform):
    flying = (navigating(f"AC{index}", route) for index, route in enumerate(SECTOR.routes))
    reports = fly(platform, scenario(*flying, cycles=160))
    speed_m_s = column(reports, "ground_speed_kt")[0, 0] * KT_M_S
    radius_nm = speed_m_s**2 / (G_M_S2 * np.tan(np.radians(BANK_DEG))) / 1852.0
    half_cycle_nm = 3.0 * speed_m_s / 1852.0
    for index, route in enumerate(SECTOR.routes):
        position_nm = SECTOR.plane.to_plane(
            column(reports, "lat")[:, index], column(reports, "lon")[:, index]
        )
        for name, turn_deg in zip(route[1:], [*turns_deg(route, SECTOR.fixes), 0.0], strict=True):
            nearest_nm = np.linalg.norm(position_nm - SECTOR.fixes_nm[name], axis=1).min()
            corner_nm = radius_nm * (1.0 / np.cos(np.radians(turn_deg / 2.0)) - 1.0)
            assert corner_nm - 0.1 < nearest_nm < np.hypot(corner_nm, half_cycle_nm) + 0.1
    np.testing.assert_array_equal(
        column(reports, "cleared_heading_deg"), column(reports, "heading_deg")
    )


def test_heading_clearance_ends_own_navigation(platform):
    flown = scenario(
        navigating("AC1", BENT),
        clearances=(ScheduledClearance(2, "AC1", heading_deg=123),),
        cycles=100,
    )
    reports = fly(platform, flown)
    assert column(reports, "heading_deg")[-1, 0] == 123.0
    np.testing.assert_array_equal(column(reports, "cleared_heading_deg")[3:, 0], 123.0)


@pytest.mark.slow
def test_flies_direct_to_a_fix_and_then_along_the_route(platform):
    """The turn begins at once; the fix is passed, and the rest of the route is flown."""
    away_deg = round(SECTOR.first_heading_deg(BENT)) + 20
    flown = scenario(
        navigating("AC1", BENT),
        clearances=(
            ScheduledClearance(2, "AC1", heading_deg=away_deg),
            ScheduledClearance(12, "AC1", direct_to=BENT[2]),
        ),
        cycles=200,
    )
    reports = fly(platform, flown)
    lat, lon = column(reports, "lat")[:, 0], column(reports, "lon")[:, 0]
    heading = column(reports, "heading_deg")[:, 0]
    assert heading[12] == away_deg != heading[13]
    position_nm = SECTOR.plane.to_plane(lat, lon)
    for name in BENT[2:]:
        assert np.linalg.norm(position_nm - SECTOR.fixes_nm[name], axis=1).min() < 1.5
    # On own navigation the cleared heading is the actual one.
    cleared = column(reports, "cleared_heading_deg")[:, 0]
    np.testing.assert_array_equal(cleared[13:], heading[13:])


@pytest.mark.slow
def test_flights_do_not_depend_on_earlier_ones(platform):
    first = {id(flown): fly(platform, flown) for flown in (INSTRUCTED, NAVIGATING)}
    for flown in (INSTRUCTED, NAVIGATING):
        np.testing.assert_array_equal(fly(platform, flown), first[id(flown)])


def test_flies_the_same_after_the_first_folder_is_deleted(tmp_path):
    flown = []
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        opened = BlueSky(folder)
        flown.append(fly(opened, INSTRUCTED))
        opened.close()
        shutil.rmtree(folder)
    np.testing.assert_array_equal(*flown)


def test_only_one_can_be_open(platform, tmp_path):
    with pytest.raises(PlatformError, match="already open"):
        BlueSky(tmp_path)
    platform.reset(INSTRUCTED)


PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from skystack.platforms.bluesky import BlueSky
from tests.platforms.test_bluesky import NAVIGATING, INSTRUCTED, fly
platform = BlueSky(Path(sys.argv[1]))
np.savez(sys.argv[2], instructed=fly(platform, INSTRUCTED), navigating=fly(platform, NAVIGATING))
platform.close()
"""


@pytest.mark.slow
def test_new_process_flies_the_same_and_leaves_no_files(platform, tmp_path):
    home, work, folder = (tmp_path / name for name in ("home", "work", "folder"))
    for made in (home, work, folder):
        made.mkdir()
    result = tmp_path / "flown.npz"
    repository = Path(__file__).parents[2]
    environment = {
        **os.environ,
        "HOME": str(home),
        "MPLCONFIGDIR": str(tmp_path / "matplotlib"),
        "PYTHONPATH": os.pathsep.join([str(repository), str(repository / "src")]),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    completed = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), str(result)],
        cwd=work,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (completed.returncode, completed.stdout, completed.stderr) == (0, "", "")
    assert list(home.iterdir()) == list(work.iterdir()) == []
    with np.load(result) as flown:
        np.testing.assert_array_equal(flown["instructed"], fly(platform, INSTRUCTED))
        np.testing.assert_array_equal(flown["navigating"], fly(platform, NAVIGATING))


REPLAY = """
import sys
import numpy as np
import bluesky
folder, scenario, cycles, result = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
bluesky.init(mode="sim", detached=True, workdir=folder)
bluesky.stack.stack("IC " + scenario)
bluesky.sim.step()
rows = []
for cycle in range(cycles):
    for _ in range(6):
        bluesky.sim.step()
    traffic = bluesky.traf
    rows.append([traffic.lat, traffic.lon, traffic.alt / 30.48, traffic.hdg])
ended_s = bluesky.sim.simt
bluesky.sim.step()
np.savez(result, rows=rows, ended_s=[ended_s, bluesky.sim.simt])
"""


@pytest.mark.slow
@pytest.mark.parametrize("flown", [INSTRUCTED, NAVIGATING], ids=["instructed", "own navigation"])
def test_plain_bluesky_flies_the_scenario_file_the_same(platform, tmp_path, flown):
    file = tmp_path / "flown.scn"
    file.write_text(scenario_text(flown))
    rows, ended_s = replay(file, flown.cycles, tmp_path)
    np.testing.assert_allclose(rows, fly(platform, flown)[1:, :4], rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(ended_s, 6.0 * flown.cycles)


def replay(file, cycles, folder):
    """The rows [cycle, column, aircraft] that plain BlueSky flies, and when it stops."""
    result = folder / "flown.npz"
    command = [sys.executable, "-c", REPLAY, folder, file, str(cycles), result]
    subprocess.run(command, cwd=folder, capture_output=True, check=True)
    with np.load(result) as replayed:
        return replayed["rows"], replayed["ended_s"]


@pytest.mark.slow
@pytest.mark.usefixtures("one_process")
def test_plain_bluesky_reproduces_an_evaluation(tmp_path):
    """A policy's clearances, exported from the stored tables and flown by BlueSky alone."""
    number = 1
    conditions = Conditions(episodes=number + 1, platform="bluesky")
    evaluate(find_policy("lateral-best"), conditions, tmp_path)
    folder = evaluation_folder(tmp_path, "lateral-best", 0, True, "bluesky")
    export_scenario(folder, number, tmp_path / "one.scn")
    only = [("scenario", "=", number), ("cycle", ">", 0)]
    table = pq.read_table(folder / "trajectories.parquet", filters=only)
    assert table.num_rows > 200
    rows, _ = replay(tmp_path / "one.scn", table.num_rows // 2, tmp_path)
    flying = np.array(table["status"].to_pylist()) != "exited"
    for place, name in enumerate(("lat", "lon", "fl", "heading_deg")):
        # Positions are stored as float32, and exited aircraft stay where they are.
        flown = rows[:, place].reshape(-1)
        np.testing.assert_allclose(flown[flying], np.array(table[name])[flying], atol=1e-4)


def test_lists_the_types_that_bluesky_knows(platform):
    known = {name.upper() for name in bluesky.traf.perf.coeff.actypes_fixwing}
    assert known == TYPES


def test_flies_any_callsign(platform):
    callsigns = ("a, b;DEL *", "#", "HDG")
    platform.reset(scenario(*(aircraft(callsign) for callsign in callsigns)))
    platform.issue(Instruction("#", heading_deg=90))
    np.testing.assert_array_equal(platform.advance().cleared_heading_deg, [45.0, 90.0, 45.0])


@pytest.mark.parametrize("aircraft_type", ["XXXX", "b752", "B752,0", "EC35"])
def test_rejects_unknown_types(platform, aircraft_type):
    with pytest.raises(InputError, match=f"AC1: type '{aircraft_type}'.*as B752"):
        platform.reset(scenario(aircraft(type=aircraft_type)))


def test_flies_known_types(platform):
    platform.reset(scenario(aircraft(type="A320"), aircraft("AC2")))
    assert list(bluesky.traf.perf.actype) == ["A320", "B752"]


def test_rejects_levels_above_the_ceiling(platform):
    with pytest.raises(InputError, match=r"fl is 500.0 for AC1 \(allowed: up to FL382"):
        platform.reset(scenario(aircraft(fl=500.0)))
    platform.reset(scenario())
    with pytest.raises(InputError, match=r"fl is 500 for AC1 \(allowed: up to FL382"):
        platform.issue(Instruction("AC1", level_fl=500))


def test_rejects_turns_the_longer_way(platform):
    platform.reset(scenario())
    for turn, heading in (("left", 46), ("right", 44), ("right", 225)):
        with pytest.raises(InputError, match=f"turn is '{turn}' for AC1 from heading 45"):
            platform.issue(Instruction("AC1", heading, turn, by_direction=True))
    platform.issue(Instruction("AC1", 46, "left"))
    platform.issue(Instruction("AC1", 44, "left", by_direction=True))
    assert platform.advance().heading_deg[0] == 44.0


def test_detects_a_lost_aircraft(platform):
    platform.reset(INSTRUCTED)
    bluesky.stack.stack("DEL AC0001")
    with pytest.raises(PlatformError, match="lost AC2"):
        platform.advance()


@pytest.mark.parametrize("fields", [{"heading_deg": 90}, {"level_fl": 310}])
def test_detects_clearances_that_bluesky_ignores(platform, monkeypatch, fields):
    platform.reset(INSTRUCTED)
    monkeypatch.setattr(bluesky.stack, "stack", lambda *_: None)
    with pytest.raises(PlatformError, match=r"refused.*AC1"):
        platform.issue(Instruction("AC1", **fields))


def test_prints_nothing(tmp_path, capfd):
    opened = BlueSky(tmp_path)
    fly(opened, INSTRUCTED)
    with pytest.raises(InputError):
        opened.reset(scenario(aircraft(type="XXXX")))
    opened.close()
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_flies_the_levels_that_the_file_assumes(platform):
    """Climbs that are reversed, short or repeated; BlueSky itself is the reference."""
    rng = np.random.default_rng(5)
    cycles = np.cumsum(rng.integers(1, 8, 20)).tolist()
    cleared = dict(zip(cycles, (10 * rng.integers(20, 38, 20)).tolist(), strict=True))
    clearances = tuple(ScheduledClearance(cycle, "AC1", fl=fl) for cycle, fl in cleared.items())
    flown = scenario(clearances=clearances, cycles=120)
    reports = fly(platform, flown)
    expected = levels_fl(300.0, cleared, 120, flown.performance_of("B753").rate_ft_min)
    levels = [fl for fl, _ in expected]
    np.testing.assert_allclose(column(reports, "fl")[:-1, 0], levels, rtol=0.0, atol=1e-6)
    assert len(set(levels)) > 60
    fast = replace(scenario(aircraft(fl=300.24)), fleet=(AircraftType("B753", rate_ft_min=3000.0),))
    climb = replace(fast, clearances=(ScheduledClearance(0, "AC1", fl=310),), cycles=4)
    levels = [fl for fl, _ in levels_fl(300.24, {0: 310}, 5, 3000.0)]
    np.testing.assert_allclose(
        column(fly(platform, climb), "fl")[:, 0], levels, rtol=0.0, atol=1e-6
    )


def test_obeys_the_ceiling_of_the_fleet_type(platform):
    """Above the ceiling of its type, an aircraft may hold its level or descend."""
    low = AircraftType("B753", ceiling_fl=300.0)
    flown = replace(scenario(aircraft(fl=290.0)), fleet=(low,))
    platform.reset(flown)
    platform.issue(Instruction("AC1", level_fl=300))
    with pytest.raises(
        InputError, match=r"fl is 310 for AC1 \(allowed: up to FL300, the ceiling of"
    ):
        platform.issue(Instruction("AC1", level_fl=310))
    platform.reset(replace(flown, aircraft=(aircraft(fl=320.0),)))
    platform.issue(Instruction("AC1", level_fl=320))
    platform.issue(Instruction("AC1", level_fl=310))
    with pytest.raises(InputError, match="up to FL300"):
        platform.issue(Instruction("AC1", level_fl=330))


def test_detects_an_aircraft_that_was_not_created(platform, monkeypatch):
    stack = bluesky.stack.stack

    def skip_first_aircraft(*commands):
        stack(*(each for each in commands if not each.startswith("CRE AC0000")))

    monkeypatch.setattr(bluesky.stack, "stack", skip_first_aircraft)
    message = r"created \['AC0001'\] for \['AC1', 'AC2'\]"
    with pytest.raises(PlatformError, match=message):
        platform.reset(INSTRUCTED)


def test_rejects_airspeeds_outside_the_envelope(platform):
    """At FL160, where no Mach number is too high. The limits themselves are flown."""

    def with_cas(cas_kt):
        kind = AircraftType("B752", high_cas_kt=(cas_kt,) * 3, mach=(0.8,) * 3)
        return replace(scenario(aircraft(type="B752", fl=160.0)), fleet=(kind,))

    platform.reset(with_cas(250.0))
    performance = bluesky.traf.perf
    low, high = (float(each[0]) / KT_M_S for each in (performance.vmin, performance.vmax))
    for limit, beyond in ((low, low - 1.0), (high, high + 1.0)):
        assert platform.reset(with_cas(limit)).fl[0] == 160.0
        message = (
            rf"AC1 flies {beyond:.0f} kt CAS, M0\.\d\d, at FL160 .*: {low:.0f} to {high:.0f} kt"
        )
        with pytest.raises(InputError, match=message):
            platform.reset(with_cas(beyond))


def test_rejects_mach_numbers_above_the_maximum(platform):
    """At FL380, where the airspeed is well within the envelope. The maximum itself is flown."""

    def with_mach(mach):
        kind = AircraftType("B752", high_cas_kt=(380.0,) * 3, mach=(mach,) * 3)
        return replace(scenario(aircraft(type="B752", fl=380.0)), fleet=(kind,))

    platform.reset(with_mach(0.7))
    maximum = float(bluesky.traf.perf.mmo[0])
    assert platform.reset(with_mach(maximum)).fl[0] == 380.0
    message = rf"M{maximum + 0.01:.2f}, at FL380 .* to 3\d\d kt, up to M{maximum:.2f}\)"
    with pytest.raises(InputError, match=message):
        platform.reset(with_mach(maximum + 0.01))
