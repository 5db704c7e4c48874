"""Arriving traffic in BlueSky: flights enter, obey, avoid each other and leave."""

from contextlib import closing

import pytest

pytest.importorskip("bluesky")

from skystack.airspace.xplus import x_plus
from skystack.errors import PlatformError
from skystack.platforms.bluesky_traffic import BlueskyTraffic, Newborn
from skystack.platforms.instruction import Instruction

SECTOR = x_plus()
ROUTE = ("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT")


def newborn(lat=0.0, lon=0.0, heading_deg=90.0, **changes):
    return Newborn(ROUTE, 300.0, 340.0, lat, lon, heading_deg, 400.0, 2000.0)._replace(**changes)


@pytest.fixture
def traffic():
    found = BlueskyTraffic(SECTOR.fixes)
    found.reset()
    yield found
    found.close()


def fly(traffic, cycles):
    for _ in range(cycles):
        reports = traffic.advance()
    return reports


def test_flights_enter_and_leave(traffic):
    traffic.enter("AC1", newborn())
    assert set(fly(traffic, 2)) == {"AC1"}
    traffic.enter("AC2-2", newborn(lat=0.5))
    assert set(fly(traffic, 1)) == {"AC1", "AC2-2"}
    traffic.remove("AC1")
    reports = fly(traffic, 1)
    assert set(reports) == {"AC2-2"}
    assert reports["AC2-2"].lat == pytest.approx(0.5, abs=1e-6)
    traffic.reset()
    assert fly(traffic, 1) == {}


@pytest.mark.slow
@pytest.mark.parametrize("airspeed_kt", [350.0, 430.0])
@pytest.mark.parametrize("fl", [210.0, 300.0, 400.0])
def test_flights_keep_their_airspeed_at_all_levels(traffic, airspeed_kt, fl):
    """On the equator, a minute of longitude is 1.00174 NM long in WGS-84, 1 NM on BlueSky's."""
    traffic.enter("AC1", newborn(airspeed_kt=airspeed_kt, entry_fl=fl))
    report = fly(traffic, 100)["AC1"]
    assert report.airspeed_kt == pytest.approx(airspeed_kt, abs=0.01)
    assert 60.0 * report.lon == pytest.approx(airspeed_kt / 6.0, rel=0.003)
    assert (report.fl, report.heading_deg) == (fl, pytest.approx(90.0, abs=0.01))


def test_instructions_are_obeyed(traffic):
    traffic.enter("AC1", newborn())
    traffic.issue(Instruction("AC1", heading_deg=0, level_fl=340))
    report = fly(traffic, 1)["AC1"]
    assert (report.cleared_heading_deg, report.cleared_fl) == (0.0, 340.0)
    assert not report.own_navigation
    report = fly(traffic, 40)["AC1"]
    assert report.heading_deg == pytest.approx(0.0, abs=0.01)
    assert report.fl == 340.0
    traffic.issue(Instruction("AC1", direct_to="QUAIL", level_fl=300))
    report = fly(traffic, 1)["AC1"]
    assert report.own_navigation
    assert report.next_fix == "QUAIL"
    report = fly(traffic, 10)["AC1"]
    assert -2100.0 < report.vertical_speed_ft_min < -1900.0
    assert fly(traffic, 40)["AC1"].next_fix in {"QUAIL", "SWIFT"}
    traffic.issue(Instruction("AC1", heading_deg=180))
    assert not fly(traffic, 1)["AC1"].own_navigation


def test_a_flight_that_bluesky_does_not_create_is_named(traffic):
    with pytest.raises(PlatformError, match="BlueSky did not create"):
        traffic.enter("AC1", newborn(lat=float("nan")))


@pytest.mark.parametrize("avoids", [False, True])
def test_mvp_avoids_a_loss_of_separation(avoids):
    """Two flights meet head-on, 40 NM apart at the start: without MVP, they pass within 1 NM."""
    with closing(BlueskyTraffic(SECTOR.fixes, avoids)) as traffic:
        nearest_nm = nearest_head_on(traffic)
    assert (nearest_nm > 4.9) == avoids
    assert (nearest_nm < 1.0) != avoids


def nearest_head_on(traffic):
    """The least distance of two flights that are not separated vertically."""
    traffic.reset()
    traffic.enter("AC1", newborn(lon=-20.0 / 60.0))
    traffic.enter("AC2", newborn(lon=20.0 / 60.0, heading_deg=270.0))
    nearest_nm = 40.0
    for _ in range(60):
        one, other = traffic.advance().values()
        apart_nm = 60.0 * ((one.lat - other.lat) ** 2 + (one.lon - other.lon) ** 2) ** 0.5
        if abs(one.fl - other.fl) < 10.0:
            nearest_nm = min(nearest_nm, apart_nm)
    return nearest_nm


def test_only_one_can_be_open(traffic):
    with pytest.raises(PlatformError, match="already open"):
        BlueskyTraffic(SECTOR.fixes)
