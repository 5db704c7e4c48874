"""Skystack against the real BluebirdDT, on a fixed set of random scenarios and a known bug.

`python -m verification.simulator.bluebird_agreement` compares hundreds of scenarios.
"""

import pytest

pytest.importorskip("bluebird_dt")

from skystack.platforms.bluebird import Bluebird
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from skystack.simulator.scenario_file import TURNS
from tests.scenarios import changed, load
from verification.simulator import bluebird_agreement as agreement


@pytest.fixture(scope="module")
def platforms():
    return Skystack(), Bluebird()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sector", "model", "rollouts"),
    [
        ("x-plus", "table", 2),
        ("x-plus", "constant", 2),
        ("crossing", "table", 1),
        ("north", "table", 1),
        ("arctic", "constant", 1),
        ("south", "table", 1),
        ("dateline", "constant", 1),
    ],
)
@pytest.mark.parametrize("kind", agreement.KINDS)
def test_random_flights_agree_row_by_row(platforms, sector, model, kind, rollouts):
    # In these flights no fly-by turn begins a second apart.
    bound = agreement.BOUNDS[kind] if kind == agreement.INSTRUCTED else agreement.TO_FIXES
    seeds, place = range(rollouts), agreement.sector_of(sector)
    found = agreement.measure(platforms, seeds, model, kind, place)
    for name, value, limit in zip(bound._fields, found.worst, bound, strict=True):
        assert value <= limit, name
    assert found.worst.position_nm > 0.0  # two simulators, not one twice
    assert found.rows > 400 * rollouts  # of 602 per rollout; the others are too far out


def test_random_scenarios_contain_every_kind_of_clearance(platforms):
    ours, _ = platforms
    turns, long_turns, compound, level_only, unfinished = set(), 0, 0, 0, 0
    for seed in range(6):
        scenario = agreement.random_scenario(
            seed, "table", agreement.INSTRUCTED, agreement.sector_of("x-plus")
        )
        index = {one.callsign: place for place, one in enumerate(scenario.aircraft)}
        reports = fly_scenario(ours, scenario).reports
        for cycle, clearances in scenario.transmissions().items():
            for given in clearances:
                report, number = reports[cycle], index[given.callsign]
                turns.add(given.turn)
                compound += given.heading_deg is not None and given.fl is not None
                level_only += given.heading_deg is None
                actual, cleared = report.heading_deg[number], report.cleared_heading_deg[number]
                unfinished += given.heading_deg is not None and actual != cleared
                if given.turn in {"left", "right"}:
                    right = (given.heading_deg - actual) % 360.0
                    long_turns += (right if given.turn == "right" else 360.0 - right) > 180.0
    assert turns >= set(TURNS)
    assert min(long_turns, compound, level_only, unfinished) > 10


def headings(platform, tmp_path, turn_to):
    """The headings in rows 4 to 7, from 045, of an aircraft cleared to turn right the long way."""
    scenario = changed(("aircraft", 0, "heading_deg"), 45.0)
    clearance = {"cycle": 3, "callsign": "AC1", "heading_deg": turn_to, "turn": "right"}
    scenario["clearances"] = [clearance]
    flight = fly_scenario(platform, load(scenario, tmp_path))
    return [float(report.heading_deg[0]) for report in flight.reports[4:8]]


def test_bluebird_snaps_to_a_heading_one_degree_away(platforms, tmp_path):
    """BluebirdDT 0.4.0 compares the smallest difference with the turn of one second: a turn by
    direction that starts this close to its target ends at once, the wrong way. Skystack's does not.
    """
    ours, theirs = (headings(platform, tmp_path, 44) for platform in platforms)
    assert theirs == [45.0, 44.0, 44.0, 44.0]
    assert ours == pytest.approx([45.0, 54.0, 63.0, 72.0], abs=1e-4)


def test_both_turn_the_long_way_from_two_degrees_away(platforms, tmp_path):
    ours, theirs = (headings(platform, tmp_path, 43) for platform in platforms)
    assert theirs == pytest.approx([45.0, 54.0, 63.0, 72.0], abs=1e-4)
    assert ours == pytest.approx(theirs, abs=1e-4)
