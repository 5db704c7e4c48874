"""BluebirdDT's own arriving traffic, by callsign."""

import pytest

pytest.importorskip("bluebird_dt")

from skystack.errors import PlatformError
from skystack.platforms import bluebird_traffic
from skystack.platforms.bluebird_traffic import FlightSchoolTraffic
from skystack.platforms.instruction import Instruction
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL

CYCLES = 60


@pytest.fixture
def traffic():
    found = FlightSchoolTraffic(FLIGHT_SCHOOL["category"])
    yield found
    found.close()


def flown(traffic, cycles=CYCLES, seed=3):
    """The reports of every cycle."""
    reports = [traffic.reset(seed)]
    for _ in range(cycles):
        reports.append(traffic.advance())
    return reports


def test_starters_are_inside_and_others_are_born_later(traffic):
    reports = flown(traffic)
    assert len(reports[0]) == 2
    assert len(reports[-1]) > 8
    assert not any(report.held for report in reports[0].values())
    for report in reports[-1].values():
        assert 350.0 <= report.airspeed_kt <= 450.0
        assert 200.0 <= report.exit_fl <= 400.0
        assert report.exit_fl % 10.0 == 0.0


def test_the_ground_speed_is_lower_in_a_climb(traffic):
    """It is the horizontal part of the airspeed; 2,000 ft/min are 19.75 kt."""
    now = flown(traffic)[-1]
    callsign = next(each for each, report in now.items() if not report.held and report.fl < 350.0)
    traffic.issue(Instruction(callsign, level_fl=400))
    level, _, climbing = (traffic.advance()[callsign] for _ in range(3))
    assert level.vertical_speed_ft_min == 0.0
    assert level.ground_speed_kt == pytest.approx(level.airspeed_kt)
    assert climbing.vertical_speed_ft_min == 2000.0
    assert climbing.airspeed_kt == level.airspeed_kt
    vertical_kt = 2000.0 * 0.3048 * 60.0 / 1852.0
    expected_kt = (climbing.airspeed_kt**2 - vertical_kt**2) ** 0.5
    assert climbing.ground_speed_kt == pytest.approx(expected_kt, abs=1e-6)


def test_newborns_are_put_back_and_lose_their_clearances(traffic):
    reports = flown(traffic)
    born = next(
        (cycle, callsign)
        for cycle, now in enumerate(reports)
        for callsign, report in now.items()
        if report.held
    )
    cycle, callsign = born
    held = [now[callsign].held for now in reports[cycle:]]
    count = held.index(False)
    assert 1 <= count <= 3
    assert not any(held[count:])
    traffic.reset(3)
    for _ in range(cycle):
        now = traffic.advance()
    level_fl = 200 if now[callsign].fl > 300.0 else 400
    traffic.issue(Instruction(callsign, level_fl=level_fl))
    for _ in range(count):
        now = traffic.advance()
    assert not now[callsign].held
    assert now[callsign].cleared_fl == now[callsign].entry_fl  # it never heard
    traffic.issue(Instruction(callsign, level_fl=level_fl))
    assert traffic.advance()[callsign].cleared_fl == level_fl


def test_a_clearance_direct_to_a_fix_is_for_one_flight_only(traffic):
    """In BluebirdDT, flights with the same route share it, so the others would lose their place."""
    now = flown(traffic)[-1]
    one, other = next(
        (one, other)
        for one in now
        for other in now
        if one < other and now[one].route == now[other].route and not now[other].held
    )
    for callsign in (one, other):
        traffic.issue(Instruction(callsign, direct_to=now[callsign].route[2]))
    traffic.advance()
    traffic.issue(Instruction(one, direct_to=now[one].route[-1]))
    after = traffic.advance()
    assert after[one].next_fix == now[one].route[-1]
    assert after[other].next_fix == now[other].route[2]
    assert after[other].own_navigation


def test_an_hour_depends_on_its_seed(traffic):
    first, again, other = (flown(traffic, 20, seed)[-1] for seed in (3, 3, 4))
    assert first == again
    assert first != other


@pytest.mark.slow
def test_flights_are_the_same_if_bluebird_records_every_cycle(traffic, monkeypatch):
    def cleared():
        """The reports of every cycle. All flights are cleared to another level along the way."""
        reports = flown(traffic, CYCLES // 2)
        for callsign, report in reports[-1].items():
            traffic.issue(Instruction(callsign, level_fl=200 if report.fl > 300.0 else 400))
        records = traffic._simulator.manager.event_logger
        return reports + [traffic.advance() for _ in range(CYCLES // 2)], records

    without, records = cleared()
    assert not records.clearances_log
    monkeypatch.setattr(bluebird_traffic, "stop_logging", lambda _: None)
    recorded, records = cleared()
    assert records.clearances_log
    assert without == recorded


def test_a_failure_of_bluebird_is_reported_in_one_line(traffic, monkeypatch):
    traffic.reset(3)

    def fail(_):
        raise IndexError("list index out of range")

    monkeypatch.setattr(traffic._simulator, "evolve", fail)
    with pytest.raises(PlatformError, match="BluebirdDT failed: IndexError: list index"):
        traffic.advance()
