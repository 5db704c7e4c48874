"""Reports made by hand: who is in the sector when, and which losses of separation are counted."""

import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.evaluation.followed import STATUS, follow
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import Aircraft, Scenario

SECTOR = x_plus()
NM_DEG = 1.0 / 60.0
"""Near enough, on the equator."""


def flight(*aircraft, route=SECTOR.routes[0]):
    """A scenario and its reports, from rows of (lat, lon, FL) of each aircraft."""
    places = np.array(aircraft, dtype=float)
    flying = tuple(
        Aircraft(f"AC{number + 1}", "B753", route, *rows[0], 45.0, 300, False)
        for number, rows in enumerate(places.tolist())
    )
    zero = np.zeros(len(aircraft))
    reports = [
        Report(lat, lon, fl, zero, zero, fl, zero + 450.0, zero)
        for lat, lon, fl in places.transpose(1, 2, 0)
    ]
    return Scenario(SECTOR, "table", len(reports) - 1, flying, ()), reports


def beside_exit(route, part):
    """On the leg before the exit fix or, of a positive part, on the last leg behind it."""
    exit_fix = np.array(SECTOR.fixes[route[-2]])
    other = np.array(SECTOR.fixes[route[-1 if part > 0.0 else -3]])
    return (exit_fix + abs(part) * (other - exit_fix)).tolist()


def test_the_status_of_every_row():
    """One comes out right; one never enters; one leaves the levels, comes back and comes out
    right; one leaves the levels and stays away."""
    route = SECTOR.routes[0]
    within, beyond = beside_exit(route, -0.1), beside_exit(route, 0.1)
    start = SECTOR.fixes[route[0]]
    seen = follow(
        *flight(
            [(*within, 300), (*beyond, 300), (*beyond, 300)],
            [(*start, 300), (*start, 300), (*start, 300)],
            [(*within, 300), (*within, 410), (*beyond, 300)],
            [(*within, 300), (*within, 190), (*within, 300)],
        )
    )
    assert [[STATUS[each] for each in row] for row in seen.status] == [
        ["in_sector", "before_entry", "in_sector", "in_sector"],
        ["exited", "before_entry", "excursion", "excursion"],
        ["exited", "before_entry", "exited", "excursion"],
    ]


def apart(distances_nm, fl=300):
    """Two that start at the origin: the second lies so far east of the first."""
    return [(0.0, 0.0, 300)] * len(distances_nm), [
        (0.0, distance * NM_DEG, fl) for distance in distances_nm
    ]


def test_losses_are_counted_when_they_begin():
    """Two: from row 0 to 3 and from row 4 on. Between them they are 20 NM apart for a cycle."""
    seen = follow(*flight(*apart([10, 4, 3, 20, 20, 2, 2])))
    assert seen.losses == 2
    assert seen.min_separation_nm == pytest.approx(2.0, rel=0.01)


def test_without_vertical_separation_there_is_no_distance():
    seen = follow(*flight(*apart([10, 4, 3, 20, 20, 2, 2], fl=310)))
    assert (seen.losses, seen.min_separation_nm) == (0, np.inf)


def test_one_aircraft_loses_no_separation():
    seen = follow(*flight(apart([10, 4])[1]))
    assert (seen.losses, seen.min_separation_nm) == (0, np.inf)


def test_exited_aircraft_are_no_longer_checked():
    """The second comes close behind the exit, after the first has crossed it; in the cycle of the
    exit itself both are watched."""
    within, beyond = (beside_exit(SECTOR.routes[0], part) for part in (-0.1, 0.1))
    first = [(*within, 300), (*beyond, 300), (*beyond, 300), (*beyond, 300)]
    above = [(*beyond, 320), (*beyond, 320), (*beyond, 300), (*beyond, 300)]
    seen = follow(*flight(first, above))
    assert (seen.losses, seen.min_separation_nm) == (0, np.inf)
    level = [(*beyond, 300), (*beyond, 300), (*beyond, 320), (*beyond, 300)]
    seen = follow(*flight(first, level))
    assert (seen.losses, seen.min_separation_nm) == (1, pytest.approx(0.0, abs=1e-3))


def test_a_distance_that_is_just_no_loss():
    """The least one of float32 that is none, and the one before it; on the equator."""
    least = np.float32(SECTOR.loss_below_nm)
    for apart_nm, losses in ((least, 0), (np.nextafter(least, np.float32(0.0)), 1)):
        lon = SECTOR.plane.to_degrees(np.array([apart_nm, 0.0], dtype=np.float64))[1]
        seen = follow(*flight([(0.0, 0.0, 300)] * 3, [(0.0, lon, 300)] * 3))
        assert (seen.losses, seen.min_separation_nm) == (losses, apart_nm)
