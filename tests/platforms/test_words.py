"""Words against what is flown: random clearances while turns and climbs are under way."""

import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from skystack.platforms.phraseology import written
from skystack.platforms.registry import adoption_of, open_platform
from skystack.simulator.scenario_file import Aircraft, GivenClearance, Scenario

SECTOR = x_plus()
AIRCRAFT, CYCLES = 20, 60


def random_scenario(seed, aircraft=AIRCRAFT, by_direction=True, kind="B753"):
    """Several clearances each, most of them while the last one is still being flown."""
    rng = np.random.default_rng(seed)
    flying, clearances = [], []
    for number in range(aircraft):
        callsign, route = f"AC{number}", SECTOR.routes[number % len(SECTOR.routes)]
        own = number % 5 == 0
        lat, lon = SECTOR.fixes[route[0]] if own else rng.uniform(-0.4, 0.4, 2)
        heading = SECTOR.first_heading_deg(route) if own else float(rng.choice([0, 90, 180, 359.5]))
        fl = float(rng.integers(22, 37) * 10)
        flying.append(Aircraft(callsign, kind, route, lat, lon, fl, heading, 300, own))
        cycle, last_deg = int(rng.integers(0, 4)), heading
        while cycle < CYCLES - 12:
            last_deg = int(rng.choice([rng.integers(0, 361), (last_deg + 180) % 360, 0, 360]))
            turn = (
                str(rng.choice(["left", "right"])) if by_direction and rng.random() < 0.2 else None
            )
            level = int(rng.integers(22, 37) * 10) if rng.random() < 0.5 else None
            clearances.append(GivenClearance(cycle, callsign, last_deg, turn, level))
            cycle += int(rng.choice([1, 2, 3, 8, 24]))
    return Scenario(SECTOR, "table", CYCLES, tuple(flying), tuple(clearances))


def check_words(scenario, flight, at_once):
    """Compare each text with the rows that follow; returns how many turns and levels it saw."""
    index = {one.callsign: number for number, one in enumerate(scenario.aircraft)}
    heading = np.array([report.heading_deg for report in flight.reports])
    fl = np.array([report.fl for report in flight.reports])
    seen = {"turn": 0, "vertical": 0}
    for cycle, said in flight.issued:
        who, begins = index[said.callsign], cycle if at_once else cycle + 1
        if said.heading_deg is not None:
            flown = (heading[begins + 1, who] - heading[begins, who] + 180.0) % 360.0 - 180.0
            way = {"right": 1.0, "left": -1.0, None: 0.0}[said.turn]
            assert np.sign(np.round(flown, 2)) == way, (cycle, written(said))
            assert (f"turn {said.turn}" if said.turn else "fly") in written(said)
            seen["turn"] += said.turn is not None
        if said.level_fl is not None:
            climbed = fl[begins + 1, who] - fl[begins, who]
            way = {"climb": 1.0, "descend": -1.0, None: 0.0}[said.vertical]
            assert np.sign(np.round(climbed, 3)) == way, (cycle, written(said))
            assert written(said).split()[-2] == (said.vertical or "maintain")
            seen["vertical"] += said.vertical is not None
    return seen


def test_our_words_are_what_is_flown():
    platform, turns, levels = Skystack(), 0, 0
    for seed in range(15):
        scenario = random_scenario(seed)
        seen = check_words(scenario, fly_scenario(platform, scenario), at_once=False)
        turns, levels = turns + seen["turn"], levels + seen["vertical"]
    assert turns > 1500
    assert levels > 800


def test_words_in_bluebird_are_what_is_flown(tmp_path):
    pytest.importorskip("bluebird_dt")
    platform = open_platform("bluebird", tmp_path)
    assert platform.adoption == adoption_of("bluebird")
    for seed in range(2):
        scenario = random_scenario(seed, 10, by_direction=False)
        seen = check_words(scenario, fly_scenario(platform, scenario), at_once=False)
        assert min(seen.values()) > 20


def test_our_adoption_is_the_registrys(tmp_path):
    assert open_platform("skystack", tmp_path).adoption == adoption_of("skystack")


def test_half_turns_and_reversed_turns_are_worded_as_flown():
    """While turning right from 010, 190 first lies to the right and then to the left."""
    route = SECTOR.routes[0]
    one = Aircraft("FLIP", "B753", route, 0.0, 0.0, 300.0, 0.0, 300, False)
    given = (GivenClearance(0, "FLIP", 170), GivenClearance(4, "FLIP", 205))
    scenario = Scenario(SECTOR, "table", 40, (one,), given)
    flight = fly_scenario(Skystack(), scenario)
    # Heading 027 when it is issued, 036 when it is adopted: 169 degrees to the right.
    assert [written(said) for _, said in flight.issued] == [
        "FLIP turn right heading 170",
        "FLIP turn right heading 205",
    ]
    late = Scenario(SECTOR, "table", 40, (one,), (given[0], GivenClearance(3, "FLIP", 201)))
    flight = fly_scenario(Skystack(), late)
    heading = [float(report.heading_deg[0]) for report in flight.reports]
    assert heading[3] == pytest.approx(18.0)
    assert (201.0 - heading[3]) % 360.0 > 180.0  # to the left, when it is issued
    assert (201.0 - heading[4]) % 360.0 < 180.0  # to the right, when it is adopted
    assert written(flight.issued[1][1]) == "FLIP turn right heading 201"
