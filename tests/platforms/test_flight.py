"""Scenarios flown on skystack: rows, wording, and BluebirdDT's reference rollouts."""

import json

import numpy as np
import pytest

from skystack.airspace.projection import geodesic_leg
from skystack.errors import InputError
from skystack.platforms.adoption import BLUESKY, SKYSTACK
from skystack.platforms.flight import command_of, flight_rows, fly_scenario
from skystack.platforms.instruction import Instruction
from skystack.platforms.own import Skystack
from skystack.platforms.phraseology import written
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import ScheduledClearance, load_scenario
from tests.scenarios import EXAMPLES, MINIMAL, changed, load

POSITION_TOLERANCE_NM = 0.04
"""The allowed distance from BluebirdDT's positions, 140 to 190 NM from the origin."""
AIRCRAFT_1, CLEARANCE_0 = ("aircraft", 1), ("clearances", 0)


def flown(scenario):
    """The columns of the flown scenario as arrays `[cycles + 1, aircraft]`."""
    columns = flight_rows(scenario, fly_scenario(Skystack(), scenario))
    return {name: column.reshape(scenario.cycles + 1, -1) for name, column in columns.items()}


def test_rows_are_complete_and_sorted_by_cycle(tmp_path):
    scenario = load(MINIMAL, tmp_path)
    columns = flight_rows(scenario, fly_scenario(Skystack(), scenario))
    assert {len(column) for column in columns.values()} == {26}
    assert columns["callsign"].tolist() == ["AC1", "AC2"] * 13
    assert columns["cycle"].tolist() == [cycle for cycle in range(13) for _ in range(2)]
    assert columns["time_s"].tolist() == [6 * cycle for cycle in columns["cycle"].tolist()]
    # Row 0 is the start, as in the file.
    np.testing.assert_allclose(columns["lat"][:2], [-0.41, 0.7], atol=1e-6)
    np.testing.assert_allclose(columns["lon"][:2], [-0.41, 0.7], atol=1e-6)
    np.testing.assert_allclose(columns["heading_deg"][:2], [45.1920, 225.1904], atol=1e-4)
    assert columns["fl"][:2].tolist() == columns["cleared_fl"][:2].tolist() == [300.0, 300.0]
    np.testing.assert_allclose(columns["ground_speed_kt"][:2], 465.9408, atol=1e-3)
    assert columns["vertical_speed_ft_min"][:2].tolist() == [0.0, 0.0]


def test_clearance_appears_one_row_before_it_is_flown(tmp_path):
    one = {"cycle": 3, "callsign": "AC1", "heading_deg": 60, "fl": 310}
    columns = flown(load(changed(CLEARANCE_0, one), tmp_path))
    start_deg = columns["heading_deg"][0, 0]
    assert columns["cleared_heading_deg"][:5, 0].tolist() == [start_deg] * 4 + [60.0]
    assert columns["cleared_fl"][:5, 0].tolist() == [300.0] * 4 + [310.0]
    np.testing.assert_allclose(
        columns["heading_deg"][:7, 0], [start_deg] * 5 + [start_deg + 9, 60.0], atol=1e-4
    )
    assert columns["fl"][:7, 0].tolist() == [300.0] * 5 + [302.5, 305.0]
    # The other aircraft was not instructed.
    assert set(columns["cleared_fl"][:, 1]) == {300.0}
    assert set(columns["heading_deg"][:, 1]) == {columns["heading_deg"][0, 1]}


def reference_flight(performance, tmp_path):
    scenario = json.loads((EXAMPLES / "reference.json").read_text())
    return flown(load(scenario | {"performance": performance}, tmp_path))


def distance_nm(columns, aircraft, lat, lon):
    """The distance of the last position from BluebirdDT's."""
    return geodesic_leg((columns["lat"][-1, aircraft], columns["lon"][-1, aircraft]), (lat, lon))[1]


def test_second_reference_aircraft_starts_3_nm_from_its_fix():
    scenario = load_scenario(EXAMPLES / "reference.json")
    second = scenario.aircraft[1]
    bearing, distance = geodesic_leg(scenario.sector.fixes["PEL"], (second.lat, second.lon))
    assert bearing == pytest.approx(200.0, abs=1e-4)
    assert distance == pytest.approx(3.0, abs=1e-6)


def test_reference_agrees_with_bluebird_at_constant_speed(tmp_path):
    columns = reference_flight("constant", tmp_path)
    first, second = columns["heading_deg"].T
    np.testing.assert_allclose(first[[5, 6, 7, 8]], [45.1920, 45.1920, 36.1920, 35.0], atol=1e-4)
    np.testing.assert_allclose(first[[41, 42, 43, 50, 60]], [45.0, 54.0, 63.0, 126.0, 205.0])
    np.testing.assert_allclose(second[[4, 5, 6, 7]], [134.80895, 125.80895, 116.80895, 115.0])
    assert (first[300], second[300]) == (205.0, 45.0)
    assert distance_nm(columns, 0, -2.591542109, -1.130081790) < POSITION_TOLERANCE_NM
    assert distance_nm(columns, 1, 1.632091695, 1.918770306) < POSITION_TOLERANCE_NM


def test_reference_agrees_with_bluebird_at_table_speeds(tmp_path):
    columns = reference_flight("table", tmp_path)
    assert distance_nm(columns, 0, -2.950759395, -1.248507504) < POSITION_TOLERANCE_NM
    assert distance_nm(columns, 1, 1.802074, 2.344787) < POSITION_TOLERANCE_NM


def test_climb_agrees_with_bluebird():
    columns = flown(load_scenario(EXAMPLES / "climb.json"))
    assert columns["cleared_fl"][[2, 3], 0].tolist() == [100.0, 300.0]
    assert columns["fl"][[3, 4, 83], 0].tolist() == [100.0, 102.5, 300.0]
    assert columns["fl"][82, 0] < 300.0
    # Ground speed at the top of the climb and in level flight after it.
    np.testing.assert_allclose(
        columns["ground_speed_kt"][[83, 84], 0], [450.741, 465.941], atol=0.01
    )
    # On own navigation, the aircraft stays on its straight route.
    np.testing.assert_allclose(columns["heading_deg"][:, 0], 45.19, atol=0.01)


def test_head_on_pair_stays_separated():
    scenario = load_scenario(EXAMPLES / "head-on.json")
    columns = flown(scenario)
    east, north = scenario.sector.plane.to_plane(columns["lat"], columns["lon"]).T
    apart_nm = np.hypot(east[0] - east[1], north[0] - north[1])
    assert apart_nm.min() > 5.0
    assert apart_nm[0] > 95.0
    # Each ends beyond the other's start.
    assert (east[0, -1], north[0, -1]) > (east[1, 0], north[1, 0])
    assert (east[1, -1], north[1, -1]) < (east[0, 0], north[0, 0])


def transmissions(scenario):
    return [
        (cycle, written(instruction))
        for cycle, instruction in fly_scenario(Skystack(), scenario).issued
    ]


def test_heading_and_level_are_one_transmission(tmp_path):
    both = {"cycle": 3, "callsign": "AC1", "heading_deg": 35, "fl": 340}
    long_way = {"cycle": 9, "callsign": "AC1", "heading_deg": 90, "turn": "left", "fl": 200}
    scenario = load(changed(("clearances",), [both, long_way]), tmp_path)
    assert transmissions(scenario) == [
        (3, "AC1 turn left heading 035, climb FL340"),
        (9, "AC1 turn left heading 090, descend FL200"),
    ]


def test_turns_the_shorter_way_unless_given_a_direction(tmp_path):
    given = {"cycle": 0, "callsign": "AC1", "heading_deg": 60}
    shorter = flown(load(changed(CLEARANCE_0, given), tmp_path))
    longer = flown(load(changed(CLEARANCE_0, given | {"turn": "left"}), tmp_path))
    assert shorter["heading_deg"][2, 0] == pytest.approx(54.192, abs=1e-3)
    assert longer["heading_deg"][2, 0] == pytest.approx(36.192, abs=1e-3)


def test_rejects_types_without_performance_data(tmp_path):
    scenario = load(changed((*AIRCRAFT_1, "type"), "A320"), tmp_path)
    with pytest.raises(InputError, match=r"AC2: type 'A320' is unknown to skystack .*B753"):
        fly_scenario(Skystack(), scenario)


def test_platform_may_reuse_arrays_for_its_reports(tmp_path):
    class Reusing(Skystack):
        buffers = None

        def _report(self):
            report = super()._report()
            self.buffers = self.buffers or Report(*map(np.array, report))
            for buffer, values in zip(self.buffers, report, strict=True):
                buffer[:] = values
            return self.buffers

    scenario = load(MINIMAL, tmp_path)
    expected, found = (fly_scenario(kind(), scenario) for kind in (Skystack, Reusing))
    np.testing.assert_array_equal(found.reports, expected.reports)
    assert found.issued == expected.issued


def test_flights_do_not_depend_on_earlier_ones(tmp_path):
    first, other = load(MINIMAL, tmp_path), load_scenario(EXAMPLES / "climb.json")
    platform = Skystack()
    flights = [fly_scenario(platform, scenario) for scenario in (first, other, first)]
    np.testing.assert_array_equal(flights[0].reports, flights[2].reports)


@pytest.mark.parametrize(("turn", "by_direction"), [("left", True), (None, False)])
def test_command_of_converts_scheduled_clearances(turn, by_direction):
    given = ScheduledClearance(3, "AC1", 90, turn or "shortest", 310)
    assert command_of(given) == Instruction("AC1", 90, turn, by_direction, 310)
    assert command_of(ScheduledClearance(3, "AC1", fl=310)) == Instruction("AC1", level_fl=310)


class Scripted:
    """A platform that returns given reports and records when each aircraft is instructed."""

    def __init__(self, adoption, reports):
        self.adoption, self._reports, self.received = adoption, reports, []

    def reset(self, scenario):
        self._cycle = 0
        return self._reports[0]

    def issue(self, instruction):
        self.received.append((self._cycle, instruction.callsign))

    def advance(self):
        self._cycle += 1
        return self._reports[self._cycle]

    def close(self):
        pass


@pytest.mark.parametrize(
    ("adoption", "words"),
    [(SKYSTACK, "right heading 035, descend FL300"), (BLUESKY, "left heading 035, climb FL300")],
)
def test_wording_follows_the_row_of_adoption(adoption, words, tmp_path):
    """AC2 is at 040 and FL290 before cycle 3, at 030 and FL310 after it, at 090 otherwise."""
    given = {"cycle": 3, "callsign": "AC2", "heading_deg": 35, "fl": 300}
    scenario = load(changed(("clearances",), [given]), tmp_path)
    blank = Skystack().reset(scenario)
    states = {3: (40.0, 290.0), 4: (30.0, 310.0)}
    reports = [
        blank._replace(heading_deg=np.array([0.0, heading]), fl=np.array([1.0, fl]))
        for heading, fl in (states.get(row, (90.0, 300.0)) for row in range(13))
    ]
    platform = Scripted(adoption, reports)
    flight = fly_scenario(platform, scenario)
    assert platform.received == [(3, "AC2")]
    assert [(cycle, written(each)) for cycle, each in flight.issued] == [(3, f"AC2 turn {words}")]
    np.testing.assert_array_equal(flight.reports, reports)


def test_the_lowest_level_can_be_cleared(tmp_path):
    down = {"cycle": 0, "callsign": "AC1", "fl": 0}
    file = changed(("clearances",), [down]) | {"levels_fl": [0, 400]}
    assert flown(load(file, tmp_path))["cleared_fl"][1].tolist() == [0.0, 300.0]
