"""The wording of clearances matches what is flown, by brute force on the following rows."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.platforms.adoption import BLUEBIRD, BLUESKY, SKYSTACK, in_words
from skystack.platforms.flight import fly_scenario
from skystack.platforms.instruction import Instruction
from skystack.platforms.languages import cpdlc
from skystack.platforms.own import Skystack
from skystack.platforms.phraseology import written
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance
from skystack.simulator.simulator import turn_to_deg

SECTOR = replace(x_plus(), levels_fl=(100, 400))
CYCLES = 24
TURNS = {"left": -1, "right": 1, None: 0}
VERTICALS = {"descend": -1, "climb": 1, None: 0}


def random_aircraft(rng, number):
    """An aircraft at a random place and heading, on own navigation or not."""
    route = SECTOR.routes[rng.integers(len(SECTOR.routes))]
    own_navigation = bool(rng.random() < 0.3)
    lat, lon = SECTOR.fixes[route[0]] if own_navigation else rng.uniform(-0.3, 0.3, size=2).tolist()
    special = rng.choice([0.0, 359.5, 0.5, 90.0, 180.0, 270.0, 45.0])
    half_degrees, any_heading = rng.integers(720) / 2.0, rng.uniform(0.0, 360.0)
    steered_heading = rng.choice([special, rng.integers(360), half_degrees, any_heading])
    heading = SECTOR.first_heading_deg(route) if own_navigation else float(steered_heading)
    fl = float(rng.integers(11, 38) * 10 + rng.choice([0.0, 0.0, 5.0, 0.9]))
    return Aircraft(f"AC{number}", "B753", route, lat, lon, fl, heading, 300, own_navigation)


def random_clearances(rng, aircraft, directions):
    """A few clearances, often during the turn or climb of the previous one."""
    cycle, heading, level = 0, aircraft.heading_deg, aircraft.fl
    while (cycle := cycle + int(rng.integers(1, 6))) < CYCLES - 3:
        turn = None
        change = rng.choice([180, -180, 179, -179, 170, -170, 5, -5, 1, *range(-90, 91, 30)])
        target = int(rng.choice([round(heading + change) % 360, 0, 360, rng.integers(361)]))
        if rng.random() < 0.2:
            target = None
        elif rng.random() < 0.3:
            turn = str(rng.choice(directions))
        near = np.clip(level // 10 * 10 + rng.choice([-10, 0, 10, -50, 50]), 110, 380)
        fl = int(near) if target is None or rng.random() < 0.5 else None
        yield ScheduledClearance(cycle, aircraft.callsign, target, turn, fl)
        heading = heading if target is None else float(target)
        level = level if fl is None else float(fl)


def random_scenario(seed, count, directions=("shortest", "left", "right")):
    rng = np.random.default_rng(seed)
    flying = tuple(random_aircraft(rng, number) for number in range(count))
    clearances = [given for one in flying for given in random_clearances(rng, one, directions)]
    return Scenario(SECTOR, "table", CYCLES, flying, tuple(clearances))


def turn_sign(before, after):
    """1 for a right turn, -1 for a left turn, 0 for none; turns are less than 180 degrees."""
    return np.sign((after - before + 180.0) % 360.0 - 180.0)


def check_wording(scenario, flight, delay):
    """Check all wordings against the rows; returns how often each case occurred."""
    counts = {"turns": 0, "levels": 0, "half turns": 0, "reversed since issue": 0}
    index = {one.callsign: number for number, one in enumerate(scenario.aircraft)}
    for cycle, command in flight.issued:
        issue, before, after = (
            flight.reports[row] for row in (cycle, cycle + delay, cycle + delay + 1)
        )
        which = index[command.callsign]
        text, uplink = written(command), cpdlc(command).lower()
        assert (command.callsign, cycle) == (scenario.aircraft[which].callsign, cycle)
        if command.heading_deg is not None:
            heading = before.heading_deg[which]
            flown = turn_sign(heading, after.heading_deg[which])
            assert TURNS[command.turn] == flown, (cycle, command, heading)
            verb = f"turn {command.turn}" if command.turn else "fly"
            assert f"{verb} heading" in text
            assert f"{verb} heading" in uplink
            at_issue = turn_sign(issue.heading_deg[which], command.heading_deg)
            counts["turns"] += 1
            counts["half turns"] += abs(command.heading_deg % 360 - heading) == 180.0
            counts["reversed since issue"] += not command.by_direction and flown != at_issue
        if command.level_fl is not None:
            flown = np.sign(after.fl[which] - before.fl[which])
            if delay:
                assert VERTICALS[command.vertical] == flown, (cycle, command, before.fl[which])
            else:  # BlueSky needs some seconds to reverse its vertical speed
                faster = after.vertical_speed_ft_min[which] - before.vertical_speed_ft_min[which]
                assert VERTICALS[command.vertical] in (flown, np.sign(faster))
            assert f"{command.vertical or 'maintain'} FL{command.level_fl}" in text
            assert f"{command.vertical or 'maintain'}{' to' * bool(command.vertical)} fl" in uplink
            counts["levels"] += 1
            counts["reversed since issue"] += flown != np.sign(command.level_fl - issue.fl[which])
    return counts


@pytest.mark.slow
def test_skystack_wording_matches_2000_random_flights():
    platform, total = Skystack(), {}
    for seed in range(10):
        scenario = random_scenario(seed, 200)
        for name, count in check_wording(scenario, fly_scenario(platform, scenario), 1).items():
            total[name] = total.get(name, 0) + count
    assert min(total["turns"], total["levels"]) > 5000
    assert total["half turns"] > 100
    assert total["reversed since issue"] > 500


@pytest.mark.slow
def test_bluebird_wording_matches_its_flights():
    bluebird = pytest.importorskip("skystack.platforms.bluebird", exc_type=ImportError)
    scenario = random_scenario(99, 60)
    counts = check_wording(scenario, fly_scenario(bluebird.Bluebird(), scenario), 1)
    assert min(counts.values()) > 2


def test_bluesky_wording_matches_its_flights(tmp_path):
    bluesky = pytest.importorskip("skystack.platforms.bluesky", exc_type=ImportError)
    scenario = random_scenario(98, 60, directions=("shortest",))
    platform = bluesky.BlueSky(tmp_path)
    try:
        counts = check_wording(scenario, fly_scenario(platform, scenario), 0)
    finally:
        platform.close()
    assert min(counts["turns"], counts["levels"], counts["half turns"]) > 2


HALF_TURNS = [(0.0, 180), (180.0, 360), (90.0, 270), (270.0, 90)]
OVER_NORTH = [(359.5, 0), (0.0, 360), (0.5, 360), (0.5, 359), (359.5, 1)]
OVER_NORTH_TURNS = ["right", None, "left", "left", "right"]


@pytest.mark.parametrize(
    ("adoption", "expected"),
    [
        (SKYSTACK, ["right", "left", "right", "left", *OVER_NORTH_TURNS]),
        (BLUEBIRD, ["right", "left", "right", "left", *OVER_NORTH_TURNS]),
        (BLUESKY, ["left", "left", "left", "left", *OVER_NORTH_TURNS]),
    ],
)
def test_half_turns_avoid_north_except_in_bluesky(adoption, expected):
    turns = [*HALF_TURNS, *OVER_NORTH]
    commands = [Instruction("AC1", target) for _, target in turns]
    actual = np.array([heading for heading, _ in turns])
    found = in_words(commands, actual, np.zeros(len(commands)), adoption)
    assert [each.turn for each in found] == expected


def test_levels_count_as_reached_within_a_tick():
    commands = [Instruction("AC1", level_fl=300)] * 3
    found = in_words(commands, np.zeros(3), np.array([300.0 - 1e-9, 299.0, 300.1]), SKYSTACK)
    assert [each.vertical for each in found] == [None, "climb", "descend"]


def test_keeps_the_given_direction_if_there_is_a_turn():
    commands = [Instruction("AC1", 45, "left", by_direction=True)] * 2
    level = np.zeros(2)
    at_target, near_target = in_words(commands, np.array([45.0, 44.0]), level, SKYSTACK)
    assert (at_target.turn, at_target.by_direction) == (None, False)
    assert (near_target.turn, near_target.by_direction) == ("left", True)


def test_bluebird_snaps_to_headings_within_one_second():
    """Within 1.5 degrees, the given direction is neither flown nor worded."""
    commands = [Instruction("AC1", 45, "left", by_direction=True)] * 3
    actual = np.array([43.5, 43.4, 46.6])
    found = in_words(commands, actual, np.zeros(3), BLUEBIRD)
    assert [(each.turn, each.by_direction) for each in found] == [
        ("right", False),
        ("left", True),
        ("left", True),
    ]
    # If the given direction is also the shorter one, it counts as obeyed.
    (near,) = in_words(commands[:1], np.array([46.0]), np.zeros(1), BLUEBIRD)
    assert (near.turn, near.by_direction) == ("left", True)
    (ours,) = in_words(commands[:1], np.array([43.5]), np.zeros(1), SKYSTACK)
    assert (ours.turn, ours.by_direction) == ("left", True)


def test_wording_follows_the_state_of_its_own_aircraft():
    """Without a heading or level in the clearance, there is no wording for it."""
    commands = [
        Instruction("AC1", 90),
        Instruction("AC2", level_fl=300),
        Instruction("AC3", 10, level_fl=200),
    ]
    found = in_words(
        commands, np.array([100.0, 0.0, 350.0]), np.array([1.0, 310.0, 199.0]), BLUESKY
    )
    assert [(each.callsign, each.turn, each.vertical) for each in found] == [
        ("AC1", "left", None),
        ("AC2", None, "descend"),
        ("AC3", "right", "climb"),
    ]
    assert [(each.heading_deg, each.level_fl) for each in found] == [
        (each.heading_deg, each.level_fl) for each in commands
    ]


@pytest.mark.parametrize("count", [0, 1, 1000, 1024, 1025, 5000])
def test_batched_turns_equal_single_ones(count):
    """In the simulator's float32, whose rounding the wording follows; every 100th is compared."""
    random = np.random.default_rng(count)
    actual = random.uniform(0.0, 360.0, count).astype(np.float32).astype(np.float64)
    cleared = random.integers(0, 36, count) * 10.0
    found = SKYSTACK.shorter_turn_deg(actual, cleared)
    assert found.shape == (count,)
    for index in range(0, count, 100):
        one = turn_to_deg(jnp.float32([actual[index]]), jnp.float32([cleared[index]]))
        assert found[index] == np.asarray(one)[0]
    assert np.all(np.abs(found) <= 180.0)
