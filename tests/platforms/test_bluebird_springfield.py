"""BluebirdDT's Springfield, read from BluebirdDT."""

import pytest

pytest.importorskip("bluebird_dt")

from skystack.errors import InputError
from skystack.platforms.bluebird_springfield import SpringfieldTraffic, read_scenario
from skystack.platforms.instruction import Instruction

AIRPORT = "test-airport-scenario"


@pytest.fixture
def traffic():
    found = SpringfieldTraffic(AIRPORT)
    yield found
    found.close()


@pytest.fixture(scope="module")
def scenario():
    return read_scenario(AIRPORT)


def test_flights_are_those_of_the_scenario(scenario):
    """Times and levels of its files `flight.csv`, `coordination.csv` and `events.csv`."""
    first, second, third = scenario.flights
    assert [each.callsign for each in scenario.flights] == ["AIR01", "AIR02", "AIR03"]
    assert scenario.performance.types == ("MEDIUM", "HEAVY", "TURBOPROP")
    # A flight is there at the end of the cycle in which it starts: 12 s and 16 s.
    assert [each.birth_cycle for each in scenario.flights] == [0, 2, 3]
    assert [each.contact_s for each in scenario.flights] == [0.0, 90.0, 196.0]
    assert [each.fl for each in scenario.flights] == [60.0, 380.0, 230.0]
    assert [each.exit_fl for each in scenario.flights] == [220.0, 380.0, 90.0]
    assert (first.route[0], third.route[-1]) == ("EGRR", "EGRR")
    assert (second.lat, second.lon) == pytest.approx((52.61251044004581, -0.6503921175197558))


def test_arrivals_end_at_the_airport_and_other_routes_at_exit_fixes(scenario):
    sector = scenario.sector
    arrivals = [route for route in sector.routes if sector.lands(route)]
    assert {route[-1] for route in arrivals} == {"EGRR"}
    exits = {route[sector.exit_fix(route)] for route in sector.routes}
    assert exits == {"EGRR", "CHEEZ", "LEXIE", "WISKY", "AGNES", "SCIFI", "BOWNE"}


def test_each_flight_has_its_own_speeds(scenario, traffic):
    """Sampled speeds are those at which BluebirdDT flies."""
    reports = traffic.reset(0)
    for _ in range(10):
        reports = traffic.advance()
    for flight in scenario.flights:
        report = reports[flight.callsign]
        cruise = scenario.performance.airspeeds_kt[flight.kind, 1, round(report.fl)]
        assert report.airspeed_kt == pytest.approx(cruise, abs=1e-6)


def test_flights_in_contact_hold_their_headings(traffic):
    reports = traffic.reset(0)
    assert not reports["AIR01"].own_navigation
    for _ in range(15):  # contact after 90 s
        assert "AIR02" not in reports or reports["AIR02"].own_navigation
        reports = traffic.advance()
    assert not reports["AIR02"].own_navigation


def test_a_clearance_direct_to_a_fix_lasts(traffic):
    traffic.reset(0)
    traffic.issue(Instruction("AIR01", direct_to="SLUFF"))
    for _ in range(20):
        reports = traffic.advance()
        assert reports["AIR01"].own_navigation
    traffic.issue(Instruction("AIR01", heading_deg=300))
    for _ in range(20):
        reports = traffic.advance()
    assert not reports["AIR01"].own_navigation
    assert reports["AIR01"].heading_deg == pytest.approx(300.0)


def test_an_unknown_scenario_is_refused():
    with pytest.raises(InputError, match=r"^unknown Springfield scenario 'x'"):
        SpringfieldTraffic("x")
