"""Springfield's scenarios under agents, in BluebirdDT and in our simulator."""

from itertools import zip_longest

import numpy as np
import pytest

pytest.importorskip("bluebird_dt")

from skystack.errors import InputError
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.hour_scores import score
from skystack.evaluation.hour_tables import callsigns_of
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.traffic import evaluate_traffic, open_hours
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.simulator.performance import TICKS_PER_FL

NAME = "springfield:test-airport-scenario"
CYCLES = 400
CLOSE_NM, CLOSE_FL = 0.005, 0.05
SECOND_NM = 0.13
"""One second of flight. Because of rounding, a turn may begin one second earlier in a simulator."""


class Flown:
    """A scenario, flown on a platform."""

    def __init__(self, agent, platform, traffic=NAME, cycles=CYCLES):
        conditions = TrafficConditions(traffic, cycles=cycles, platform=platform)
        found = find_controller(agent, conditions)
        hours = open_hours(found, conditions)
        self.hour = HourFlyer(found.world, cycles, found.per_cycle, hours).fly(found.agent, 0, 0)
        hours.close()
        self.sector = found.world.sector
        self.scores = score(self.sector, self.hour)
        self.callsigns = callsigns_of(self.hour, found.world.flow.callsigns)

    def track(self, flight):
        """Positions and levels of a flight, by cycle."""
        cycles, slots = np.nonzero(self.hour.flight == flight)
        traffic = self.hour.traffic
        return {
            int(cycle): (traffic.position_nm[cycle, slot], traffic.level_ticks[cycle, slot])
            for cycle, slot in zip(cycles, slots, strict=True)
        }


@pytest.fixture(scope="module")
def both():
    """The search in both simulators."""
    return [Flown("search", platform) for platform in ("skystack", "bluebird")]


@pytest.mark.slow
def test_both_simulators_fly_the_same_tracks(both):
    """Turns at 3 degrees a second, speeds, climbs, births, contact and landing."""
    ours, theirs = both
    assert ours.callsigns == theirs.callsigns == ["AIR01", "AIR02", "AIR03"]
    apart_nm = []
    for flight in range(3):
        one, other = ours.track(flight), theirs.track(flight)
        for cycle, (place, level) in one.items():
            their_place, their_level = other[cycle]
            apart_nm.append(np.hypot(*(place - their_place)))
            assert abs(level - their_level) < CLOSE_FL * TICKS_PER_FL, (flight, cycle)
    assert max(apart_nm) < SECOND_NM
    assert np.mean(np.array(apart_nm) < CLOSE_NM) > 0.75


@pytest.mark.slow
def test_both_simulators_agree_on_every_exit(both):
    for ours, theirs in zip_longest(*(flown.scores.flights for flown in both)):
        assert ours[:2] == theirs[:2]
        assert abs(ours.gone - theirs.gone) <= 1


@pytest.mark.slow
def test_the_search_delivers_every_flight(both):
    assert all(row.correct for flown in both for row in flown.scores.flights)
    assert not any(flown.scores.losses for flown in both)


@pytest.mark.slow
def test_landing_has_no_exit_offset(both):
    (landing,) = [row for row in both[0].scores.flights if np.isnan(row.exit_offset_nm)]
    assert landing.exited
    assert abs(landing.extra_nm) < 0.2 * landing.flown_nm


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hours": 2}, f"traffic {NAME} is the same in every hour (allowed: one hour, one seed)"),
        ({"platform": "bluesky"}, f"traffic {NAME} with --platform bluesky (allowed: skystack"),
        ({"uncertainty": True}, f"--uncertainty cannot be used with traffic {NAME}"),
        ({"sector": "merge"}, f"--sector cannot be used with traffic {NAME}"),
        ({"traffic": "springfield:"}, "unknown Springfield scenario ''"),
        ({"traffic": "springfield"}, "unknown Springfield scenario ''"),
        ({"traffic": "springfeld:x"}, "unknown traffic 'springfeld:x' (allowed: flights per hour,"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(changes, message):
    with pytest.raises(InputError) as error:
        evaluate_traffic("no-op", TrafficConditions(NAME)._replace(**changes))
    assert message in str(error.value)


def test_the_same_scenario_is_not_flown_for_several_seeds(tmp_path):
    with pytest.raises(InputError, match="is the same in every hour"):
        fly_flight_school("no-op", TrafficConditions(NAME), range(2), tmp_path)


@pytest.mark.slow
def test_rows_and_folders_have_the_name_of_the_scenario(tmp_path):
    conditions = TrafficConditions(NAME, cycles=60)
    result = fly_flight_school("no-op", conditions, range(1), tmp_path)
    assert result.row["traffic"] == NAME
    folder = "no-op-flight-school-springfield-test-airport-scenario-cycles-60"
    assert result.folder.name == folder
    assert result.row["flights"] == 3
