"""BluebirdDT behind the platform protocol: flights, rejected input, sectors, no side effects."""

import re
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("bluebird_dt")

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.sectors import sector_named
from skystack.errors import InputError, PlatformError
from skystack.platforms.bluebird import Bluebird
from skystack.platforms.flight import fly_scenario
from skystack.platforms.instruction import Instruction
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Platform
from skystack.simulator.scenario_file import load_scenario
from tests.scenarios import EXAMPLES, MINIMAL, changed, load, renamed


@pytest.fixture(scope="module")
def platform():
    return Bluebird()


def test_implements_the_protocol(platform, tmp_path):
    assert isinstance(platform, Platform)
    report = platform.reset(load(MINIMAL, tmp_path))
    assert all(values.dtype == np.float64 and values.shape == (2,) for values in report)


@pytest.mark.parametrize("performance", ["table", "constant"])
def test_flies_the_reference_rollout_like_bluebird_itself(platform, performance, tmp_path):
    """The last rows, as measured on BluebirdDT without this adapter."""
    scenario = load_scenario(EXAMPLES / "reference.json")
    scenario = scenario.__class__(**vars(scenario) | {"performance": performance})
    last = fly_scenario(platform, scenario).reports[300]
    expected = {
        "constant": ((-2.591542109, 1.632091695), (-1.130081790, 1.918770306), 1e-7),
        "table": ((-2.950759395, 1.802074), (-1.248507504, 2.344787), 1e-6),
    }
    lat, lon, tolerance = expected[performance]
    np.testing.assert_allclose(last.lat, lat, atol=tolerance)
    np.testing.assert_allclose(last.lon, lon, atol=tolerance)
    assert last.heading_deg.tolist() == [205.0, 45.0]


def test_obeys_heading_and_level_of_one_transmission(platform, tmp_path):
    platform.reset(load(MINIMAL, tmp_path))
    platform.issue(Instruction("AC1", 60, "right", level_fl=340, vertical="climb"))
    first, second = platform.advance(), platform.advance()
    assert (first.cleared_heading_deg[0], first.cleared_fl[0]) == (60.0, 340.0)
    assert first.heading_deg[0] == pytest.approx(45.192, abs=1e-3)
    assert second.heading_deg[0] == pytest.approx(54.192, abs=1e-3)
    assert second.fl[0] == pytest.approx(302.5, abs=1e-9)
    # AC2 was not instructed, so its cleared heading is its actual one.
    assert second.cleared_heading_deg[1] == second.heading_deg[1]


PEL_SWIFT = ["PEL", "GOOSE", "ALB", "EGL", "MACAW", "QUAIL", "SWIFT"]
HERON_ROBIN = ["HERON", "CRANE", "EGL", "FINCH", "ROBIN"]
DIRECT = {
    "sector": "x-plus",
    "cycles": 180,
    "performance": "constant",
    "aircraft": [
        {"callsign": "AC1", "route": PEL_SWIFT, "lat": 0.75, "lon": -0.8, "fl": 300},
        {"callsign": "AC2", "route": HERON_ROBIN, "lat": -0.5, "lon": -0.35, "fl": 300}
        | {"own_navigation": True},
    ],
    "clearances": [
        {"cycle": 3, "callsign": "AC1", "direct_to": "GOOSE"},
        {"cycle": 40, "callsign": "AC1", "heading_deg": 90},
        {"cycle": 60, "callsign": "AC1", "direct_to": "MACAW"},  # a later fix
        {"cycle": 20, "callsign": "AC2", "direct_to": "FINCH", "fl": 340},
        {"cycle": 28, "callsign": "AC2", "direct_to": "EGL"},  # before the turn is complete
        {"cycle": 50, "callsign": "AC2", "direct_to": "FINCH"},
        {"cycle": 50, "callsign": "AC2", "heading_deg": 20},  # replaces the fix
        {"cycle": 70, "callsign": "AC2", "direct_to": "EGL"},  # behind it: a turn of 160 degrees
    ],
}


@pytest.mark.parametrize("performance", ["table", "constant"])
def test_flies_direct_to_fixes_like_our_simulator(platform, performance, tmp_path):
    scenario = load(DIRECT | {"performance": performance}, tmp_path)
    theirs, ours = (fly_scenario(each, scenario).reports for each in (platform, Skystack()))
    for row, (their, our) in enumerate(zip(theirs, ours, strict=True)):
        apart_m = WGS84.inv(their.lon, their.lat, our.lon, our.lat)[2]
        assert max(apart_m) < 0.02 * METRES_PER_NM, row
        np.testing.assert_allclose(our.cleared_fl, their.cleared_fl, err_msg=str(row))
        turned = (our.heading_deg - their.heading_deg + 180.0) % 360.0 - 180.0
        assert np.abs(turned).max() < 0.05, row


def test_flights_do_not_depend_on_earlier_ones(platform, tmp_path):
    first = load(MINIMAL, tmp_path)
    other = load_scenario(EXAMPLES / "climb.json")
    flights = [fly_scenario(platform, scenario).reports for scenario in (first, other, first)]
    np.testing.assert_array_equal(flights[0], flights[2])


def test_rejects_unknown_types_and_impossible_levels(platform, tmp_path):
    with pytest.raises(InputError, match=r"AC1: type 'X123' is unknown to BluebirdDT .*B753"):
        platform.reset(load(changed(("aircraft", 0, "type"), "X123"), tmp_path))
    platform.reset(load(MINIMAL, tmp_path))
    with pytest.raises(PlatformError, match="refused"):
        platform.issue(Instruction("AC1", level_fl=10**400))


@pytest.mark.parametrize("callsign", ["A B", "é", "点", "<b>", "*", "-1", "Z9", "X" * 40])
def test_flies_every_callsign_the_same(callsign, platform, tmp_path):
    """BluebirdDT itself refuses clearances for most of these callsigns."""
    known, other = (fly_scenario(platform, load(renamed(c), tmp_path)) for c in ("AC1", callsign))
    np.testing.assert_array_equal(known.reports, other.reports)
    assert [instruction.callsign for _, instruction in other.issued] == [callsign]


PROGRAM = """
from pathlib import Path
from skystack.platforms.flight import fly_scenario
from skystack.platforms.registry import open_platform
from skystack.simulator.scenario_file import load_scenario
import sys
platform = open_platform("bluebird", Path("work"))
fly_scenario(platform, load_scenario(Path(sys.argv[1])))
platform.close()
"""


@pytest.mark.slow
def test_prints_nothing_and_leaves_no_files(tmp_path):
    home, folder = tmp_path / "home", tmp_path / "folder"
    home.mkdir()
    folder.mkdir()
    environment = {"HOME": str(home), "MPLCONFIGDIR": str(tmp_path / "mpl"), "JAX_PLATFORMS": "cpu"}
    completed = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(EXAMPLES / "head-on.json")],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    assert (completed.stdout, completed.stderr) == ("", "")
    assert list(home.iterdir()) == list(folder.iterdir()) == []


def test_x_plus_equals_the_sector_of_bluebird():
    """Ours is generated from the paper's parameters, theirs is loaded from BluebirdDT."""
    theirs, ours = sector_named("bluebird:Xplus-Sector"), sector_named("x-plus")
    assert set(theirs.routes) == set(ours.routes)
    assert theirs.levels_fl == ours.levels_fl
    for fix, place in ours.fixes.items():
        assert np.allclose(theirs.fixes[fix], place, rtol=0.0, atol=1e-12)
    assert np.allclose(sorted(theirs.area), sorted(ours.area), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "routes"), [("I-Sector", 2), ("Y-Sector", 6), ("X-Sector", 12), ("Springfield", 47)]
)
def test_loads_its_other_sectors(name, routes):
    assert len(sector_named(f"bluebird:{name}").routes) == routes


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("X-sector", "unknown sector of BluebirdDT 'X-sector'; did you mean 'X-Sector'?"),
        ("Two Sector", "BluebirdDT's Two Sector: routes[0]: ends at SANTA, 3.28 NM inside"),
    ],
)
def test_rejects_unknown_and_unsuitable_sectors(name, message):
    with pytest.raises(InputError, match=re.escape(message)):
        sector_named(f"bluebird:{name}")


def test_rejects_levels_that_bluebird_would_round(platform, tmp_path):
    platform.reset(load(MINIMAL, tmp_path))
    with pytest.raises(InputError, match=r"level_fl is 305 for AC1 \(allowed: multiples of 10"):
        platform.issue(Instruction("AC1", level_fl=305))
    platform.issue(Instruction("AC1", level_fl=310))
    assert platform.advance().cleared_fl.tolist() == [310.0, 300.0]


def test_detects_a_lost_aircraft(platform, tmp_path):
    platform.reset(load(MINIMAL, tmp_path))
    del platform._simulator.manager.environment.aircraft["AC0001"]
    with pytest.raises(PlatformError, match=r"^BluebirdDT has lost AC2$"):
        platform.advance()
