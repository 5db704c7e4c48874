"""20,000 cycles of random worlds; the command flies a million."""

import numpy as np
import pytest

from verification.simulator import simulator_invariants
from verification.simulator.compared_flights import comparisons, draw_change
from verification.simulator.invariants import invariants
from verification.simulator.random_worlds import (
    CYCLES,
    SETTINGS,
    Flier,
    concatenate_worlds,
    draw,
    setting_of,
)
from verification.simulator.simulator_invariants import BOUNDS, batches, main, try_worlds

STEERED, NAVIGATING = (range(setting, setting + 12 * 167, 12) for setting in (3, 5))
"""Worlds of 4 aircraft of the default table, and of 6 of a fleet, half on own navigation."""


@pytest.fixture(scope="module")
def flier():
    return Flier(setting_of(STEERED[0]))


@pytest.mark.slow
def test_20_000_cycles_violate_no_invariant(flier):
    tallies = {}
    try_worlds(flier, STEERED, 0, tallies)
    try_worlds(Flier(setting_of(NAVIGATING[0])), NAVIGATING, 0, tallies)
    assert CYCLES * (len(STEERED) + len(NAVIGATING)) >= 20_000
    assert {name: tally.findings for name, tally in tallies.items() if tally.findings} == {}
    assert tallies.keys() == BOUNDS.keys()
    assert all(tally.checked > 0 for tally in tallies.values())


def perturbed(flown, part, field, change_values):
    """The flight with one field changed for aircraft 1 of every world in cycle 7."""
    rows = getattr(flown, part)
    values = np.array(getattr(rows, field))
    values[7, 1] = np.asarray(change_values(values[7, 1]), dtype=values.dtype)
    return flown._replace(**{part: rows._replace(**{field: values})})


FAULTS = [
    ("instructed", "position_nm", 1e-4, "instruct changes nothing physical"),
    ("instructed", "cleared_level_ticks", 60_000.0, "instruct changes only what is cleared"),
    ("after", "heading_deg", 0.1, "an inactive aircraft does not change"),
    ("after", "heading_deg", 360.0, "all values are finite, headings in [0, 360)"),
    ("after", "ground_speed_kt", np.nan, "all values are finite, headings in [0, 360)"),
    ("after", "position_nm", 0.5, "moves at most speed x time"),
    ("after", "heading_deg", 9.1, "turns no faster than the turn rate"),
    ("after", "level_ticks", 1.0, "no level beyond the one flown to"),
    ("after", "level_ticks", 1.0, "the level, to the tick"),
    ("after", "vertical_speed_ft_min", 1.0, "the vertical speed"),
    ("after", "ground_speed_kt", 0.002, "the ground speed"),
    ("after", "heading_deg", 0.001, "the heading"),
    ("after", "heading_deg", 0.0001, "a heading is captured exactly"),
    ("after", "position_nm", 0.0005, "the displacement"),
    ("after", "flown_level_ticks", 60_000.0, "a clearance is flown from the next cycle on"),
    ("after", "turn_deg", 0.001, "a turn begins the way that was cleared"),
]


@pytest.fixture(scope="module")
def flight(flier):
    world = concatenate_worlds([draw(1, number) for number in STEERED])
    change = concatenate_worlds([draw_change(1, number, 4) for number in STEERED])
    return world, flier.fly(world), change


def violated(quantities):
    """The invariants whose bounds are exceeded."""
    tallies = {}
    simulator_invariants.check(quantities, STEERED, tallies)
    return {name for name, tally in tallies.items() if tally.findings}


@pytest.mark.slow
@pytest.mark.parametrize(("part", "field", "by", "name"), FAULTS)
def test_detects_faults_of_one_cycle(flier, flight, part, field, by, name):
    world, flown, _ = flight
    faulty = perturbed(flown, part, field, lambda values: values + by)
    assert name in violated(
        invariants(faulty, world.clearances, flier.limits, flier.simulator.sector.plane)
    )


@pytest.mark.slow
def test_detects_standing_still(flier, flight):
    world, flown, _ = flight
    after = flown.after._replace(position_nm=flown.instructed.position_nm)
    found = violated(
        invariants(
            flown._replace(after=after),
            world.clearances,
            flier.limits,
            flier.simulator.sector.plane,
        )
    )
    assert "moves at least as its turn allows" in found


@pytest.mark.parametrize(
    ("field", "by", "names"),
    [
        ("position_nm", 0.02, {"the others are not cleared: same flight", "mirrored: position"}),
        ("position_nm", 0.02, {"shifted: position", "float64: position"}),
        ("heading_deg", 0.002, {"mirrored: heading", "float64: heading"}),
        ("heading_deg", 0.002, {"two aircraft in the other order: same flights"}),
        ("level_ticks", 1.0, {"mirrored: level, speeds", "float64: level"}),
        ("level_ticks", 1.0, {"shifted: heading, level, speeds"}),
    ],
)
def test_comparisons_detect_a_changed_flight(flier, flight, field, by, names):
    world, flown, change = flight
    faulty = perturbed(flown, "after", field, lambda values: values + by)
    assert names <= violated(comparisons(flier, world, faulty, change))


def test_detects_fly_by_turns_that_are_too_tight(flier, flight):
    world, flown, _ = flight
    faulty = perturbed(flown, "after", "next_fix", lambda values: values + 1)
    faulty = perturbed(faulty, "after", "turn_radius_nm", lambda values: values + 0.1)
    found = violated(
        invariants(faulty, world.clearances, flier.limits, flier.simulator.sector.plane)
    )
    assert "fly-by turns at 30 degrees of bank at most" in found


class StubFlier:
    """A flier that returns given flights in order, and the last one repeatedly."""

    def __init__(self, *flights):
        self._flights = list(flights)

    def fly(self, world, dtype="float32"):
        return self._flights.pop(0) if len(self._flights) > 1 else self._flights[0]


@pytest.mark.parametrize(
    ("field", "by", "name"),
    [
        ("level_ticks", 1.0, "it is not cleared: same flight as without clearances"),
        ("position_nm", 0.3, "float64, own navigation: position"),
        ("heading_deg", 6.0, "float64, own navigation: heading"),
    ],
)
def test_comparisons_detect_a_changed_second_flight(flight, field, by, name):
    world, flown, change = flight
    navigating = np.ones_like(world.start.own_navigation)
    world = world._replace(start=world.start._replace(own_navigation=navigating))
    faulty = perturbed(flown, "after", field, lambda values: values + by)
    assert name not in violated(comparisons(StubFlier(flown), world, flown, change))
    assert name in violated(comparisons(StubFlier(flown, faulty), world, flown, change))


def test_worlds_depend_only_on_seed_and_number():
    one, again, other = (draw(seed, 17).start.position_nm for seed in (3, 3, 4))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert not np.array_equal(one, draw(3, 17 + len(SETTINGS)).start.position_nm)


@pytest.mark.parametrize("count", [1, 20_000, 1_000_000])
def test_every_world_is_in_one_batch_of_its_setting(count):
    work = batches(count)
    numbers = sorted(number for each in work for number in each)
    assert numbers == list(range(len(numbers)))
    assert 0 <= len(numbers) * CYCLES - count < len(work) * CYCLES * len(SETTINGS)
    assert len({len(each) for each in work}) == 1
    assert all(len({setting_of(number) for number in each}) == 1 for each in work)


def test_findings_are_printed_with_their_place(monkeypatch, capsys):
    monkeypatch.setitem(BOUNDS, "the heading", BOUNDS["the heading"]._replace(most=-1.0))
    assert main(["--world", "1", "--seed", "2"]) == 1
    printed = capsys.readouterr()
    assert "the heading: seed 2, world 1, cycle 0, aircraft 0: " in printed.err
    assert "60 cycles of 1 worlds" in printed.err
    assert "the displacement" in printed.out
