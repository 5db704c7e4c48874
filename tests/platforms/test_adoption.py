"""The words of clearances are those of what is flown: brute force on the rows that follow."""

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
SIDES = {"left": -1, "right": 1, None: 0}
WAYS = {"descend": -1, "climb": 1, None: 0}


def random_aircraft(rng, number):
    """Anywhere on a route, headings of every kind, on own navigation or not."""
    route = SECTOR.routes[rng.integers(len(SECTOR.routes))]
    own = bool(rng.random() < 0.3)
    lat, lon = SECTOR.fixes[route[0]] if own else rng.uniform(-0.3, 0.3, size=2).tolist()
    special = rng.choice([0.0, 359.5, 0.5, 90.0, 180.0, 270.0, 45.0])
    halves, any_one = rng.integers(720) / 2.0, rng.uniform(0.0, 360.0)
    free = rng.choice([special, rng.integers(360), halves, any_one])
    heading = SECTOR.first_heading_deg(route) if own else float(free)
    fl = float(rng.integers(11, 38) * 10 + rng.choice([0.0, 0.0, 5.0, 0.9]))
    return Aircraft(f"AC{number}", "B753", route, lat, lon, fl, heading, 300, own)


def random_clearances(rng, aircraft, directions):
    """A few, often while the turn or climb of the one before is under way."""
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


def change(before, after):
    """The sign of the way from one heading to another, less than half a turn apart."""
    return np.sign((after - before + 180.0) % 360.0 - 180.0)


def checked(scenario, flight, delay):
    """Every word against the rows; returns counts of what was met."""
    met = {"turns": 0, "levels": 0, "half turns": 0, "other way than at issue": 0}
    index = {one.callsign: number for number, one in enumerate(scenario.aircraft)}
    for cycle, said in flight.issued:
        issue, before, after = (
            flight.reports[row] for row in (cycle, cycle + delay, cycle + delay + 1)
        )
        one = index[said.callsign]
        text, link = written(said), cpdlc(said).lower()
        assert (said.callsign, cycle) == (scenario.aircraft[one].callsign, cycle)
        if said.heading_deg is not None:
            flown = change(before.heading_deg[one], after.heading_deg[one])
            assert SIDES[said.turn] == flown, (cycle, said, before.heading_deg[one])
            way = f"turn {said.turn}" if said.turn else "fly"
            assert f"{way} heading" in text
            assert f"{way} heading" in link
            at_issue = change(issue.heading_deg[one], said.heading_deg)
            met["turns"] += 1
            met["half turns"] += abs(said.heading_deg % 360 - before.heading_deg[one]) == 180.0
            met["other way than at issue"] += not said.by_direction and flown != at_issue
        if said.level_fl is not None:
            flown = np.sign(after.fl[one] - before.fl[one])
            if delay:  # BlueSky's vertical speed turns round in some seconds
                assert WAYS[said.vertical] == flown, (cycle, said, before.fl[one])
            else:
                faster = after.vertical_speed_ft_min[one] - before.vertical_speed_ft_min[one]
                assert WAYS[said.vertical] in (flown, np.sign(faster))
            assert f"{said.vertical or 'maintain'} FL{said.level_fl}" in text
            assert f"{said.vertical or 'maintain'}{' to' * bool(said.vertical)} fl" in link
            met["levels"] += 1
            met["other way than at issue"] += flown != np.sign(said.level_fl - issue.fl[one])
    return met


def test_ours_says_what_it_flies_in_two_thousand_random_sequences():
    platform, total = Skystack(), {}
    for seed in range(10):
        scenario = random_scenario(seed, 200)
        for name, count in checked(scenario, fly_scenario(platform, scenario), 1).items():
            total[name] = total.get(name, 0) + count
    assert min(total["turns"], total["levels"]) > 5000
    assert total["half turns"] > 100
    assert total["other way than at issue"] > 500


def test_bluebird_says_what_it_flies():
    bluebird = pytest.importorskip("skystack.platforms.bluebird", exc_type=ImportError)
    scenario = random_scenario(99, 60)
    met = checked(scenario, fly_scenario(bluebird.Bluebird(), scenario), 1)
    assert min(met.values()) > 2


def test_bluesky_says_what_it_flies(tmp_path):
    bluesky = pytest.importorskip("skystack.platforms.bluesky", exc_type=ImportError)
    scenario = random_scenario(98, 60, directions=("shortest",))
    platform = bluesky.BlueSky(tmp_path)
    try:
        met = checked(scenario, fly_scenario(platform, scenario), 0)
    finally:
        platform.close()
    assert min(met["turns"], met["levels"], met["half turns"]) > 2


HALF_TURNS = [(0.0, 180), (180.0, 360), (90.0, 270), (270.0, 90)]
OVER_NORTH = [(359.5, 0), (0.0, 360), (0.5, 360), (0.5, 359), (359.5, 1)]
ACROSS = ["right", None, "left", "left", "right"]


@pytest.mark.parametrize(
    ("adoption", "words"),
    [
        (SKYSTACK, ["right", "left", "right", "left", *ACROSS]),
        (BLUEBIRD, ["right", "left", "right", "left", *ACROSS]),
        (BLUESKY, ["left", "left", "left", "left", *ACROSS]),
    ],
)
def test_half_turns_pass_through_no_north_but_in_bluesky_which_turns_left(adoption, words):
    turns = [*HALF_TURNS, *OVER_NORTH]
    commands = [Instruction("AC1", target) for _, target in turns]
    actual = np.array([heading for heading, _ in turns])
    found = in_words(commands, actual, np.zeros(len(commands)), adoption)
    assert [each.turn for each in found] == words


def test_a_level_is_reached_within_a_tick():
    commands = [Instruction("AC1", level_fl=300)] * 3
    found = in_words(commands, np.zeros(3), np.array([300.0 - 1e-9, 299.0, 300.1]), SKYSTACK)
    assert [each.vertical for each in found] == [None, "climb", "descend"]


def test_a_direction_that_is_given_is_kept_where_there_is_a_turn():
    commands = [Instruction("AC1", 45, "left", by_direction=True)] * 2
    level = np.zeros(2)
    there, near = in_words(commands, np.array([45.0, 44.0]), level, SKYSTACK)
    assert (there.turn, there.by_direction) == (None, False)
    assert (near.turn, near.by_direction) == ("left", True)


def test_bluebird_ends_a_turn_a_second_s_turn_from_its_target_whatever_the_direction():
    """1.5 degrees: there the direction that is given is not flown, and not said."""
    commands = [Instruction("AC1", 45, "left", by_direction=True)] * 3
    actual = np.array([43.5, 43.4, 46.6])
    found = in_words(commands, actual, np.zeros(3), BLUEBIRD)
    assert [(each.turn, each.by_direction) for each in found] == [
        ("right", False),
        ("left", True),
        ("left", True),
    ]
    # Where the given one is the shorter one it is flown either way, and counts as obeyed.
    (near,) = in_words(commands[:1], np.array([46.0]), np.zeros(1), BLUEBIRD)
    assert (near.turn, near.by_direction) == ("left", True)
    (ours,) = in_words(commands[:1], np.array([43.5]), np.zeros(1), SKYSTACK)
    assert (ours.turn, ours.by_direction) == ("left", True)


def test_words_of_one_clearance_are_of_its_own_aircraft():
    """Each beside its own heading and level; what is not cleared has no words."""
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
def test_turns_of_any_number_are_those_of_each_alone(count):
    """In the simulator's float32, whose rounding the words follow; of every hundredth, alone."""
    random = np.random.default_rng(count)
    actual = random.uniform(0.0, 360.0, count).astype(np.float32).astype(np.float64)
    cleared = random.integers(0, 36, count) * 10.0
    found = SKYSTACK.shorter_turn_deg(actual, cleared)
    assert found.shape == (count,)
    for index in range(0, count, 100):
        one = turn_to_deg(jnp.float32([actual[index]]), jnp.float32([cleared[index]]))
        assert found[index] == np.asarray(one)[0]
    assert np.all(np.abs(found) <= 180.0)
