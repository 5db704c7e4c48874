"""The study of arrivals: its tests find what differs, and nothing else."""

import numpy as np
import pytest

from studies import arrivals
from studies.arrivals import Arrived, Birth, compare

HOURS = 20


def arrived(seed, speed_kt=400.0, twin=0.1, births=60):
    """Random hours."""
    rng, found, present = np.random.default_rng(seed), [], []
    for hour in range(HOURS):
        cycles = np.sort(rng.integers(1, 601, births))
        for cycle in cycles.tolist():
            for _ in range(2 if rng.uniform() < twin else 1):
                route, levels = rng.choice(["A B", "B A"]), rng.integers(20, 41, 2) * 10.0
                speed, lat, lon = rng.normal([speed_kt, 0.0, 0.0], [30.0, 0.5, 0.5]).tolist()
                found.append(Birth(hour, cycle, str(route), *levels.tolist(), speed, lat, lon))
        present.append(tuple(rng.poisson([10, 20, 30, 30, 30, 30]).tolist()))
    return Arrived(found, present)


def p_values(ours, theirs):
    return {each.what: each.p for each in compare(ours, theirs)}


def test_equal_traffic_passes_all_tests():
    assert min(p_values(arrived(0), arrived(1)).values()) > 0.001


def test_different_traffic_fails_the_tests_of_what_differs():
    speeds = p_values(arrived(0), arrived(1, speed_kt=410.0))
    assert speeds["speed"] < 1e-6
    assert min(p for what, p in speeds.items() if what != "speed") > 0.001
    twins = p_values(arrived(0), arrived(1, twin=0.4))
    assert twins["births in a cycle with births"] < 1e-6
    assert twins["births in an hour"] < 1e-3
    more = p_values(arrived(0), arrived(1, births=80))
    assert more["births in an hour"] < 1e-3
    assert more["gap between births"] < 1e-3


@pytest.mark.slow
def test_births_are_those_of_the_simulator():
    found = arrivals.in_skystack("category", 0, 1)
    assert len(found.present) == 1
    assert 200 < len(found.births) < 330
    for birth in found.births:
        assert 350.0 <= birth.speed_kt <= 450.0
        assert birth.entry_fl % 10.0 == 0.0
        assert abs(birth.lat) < 1.2


@pytest.mark.parametrize("arguments", [["categry"], ["category", "--hours", "1"]])
def test_mistakes_are_refused(capsys, arguments):
    pytest.importorskip("bluebird_dt")
    assert arrivals.main(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_hours_are_flown_once(tmp_path):
    flown = []

    def simulator(traffic, first, hours):
        flown.append((traffic, first, hours))
        return arrived(first)

    for _ in range(2):
        assert arrivals._arrived(simulator, "category", 5, 5, tmp_path) == arrived(5)
    assert flown == [("category", 5, 5)]
    arrivals._arrived(simulator, "notebook", 5, 5, tmp_path)
    assert len(flown) == 2
