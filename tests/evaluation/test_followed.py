"""Hand-made reports: the status of each aircraft, and the losses of separation counted."""

import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.evaluation.followed import STATUS, follow
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import Aircraft, Scenario

SECTOR = x_plus()
NM_DEG = 1.0 / 60.0
"""Accurate enough on the equator."""


def flight(*aircraft, route=SECTOR.routes[0]):
    """A scenario and its reports, from rows of (lat, lon, FL) for each aircraft."""
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


def near_exit(route, part):
    """A point on the leg before the exit fix or, if `part` is positive, on the leg after it."""
    exit_fix = np.array(SECTOR.fixes[route[-2]])
    other = np.array(SECTOR.fixes[route[-1 if part > 0.0 else -3]])
    return (exit_fix + abs(part) * (other - exit_fix)).tolist()


def test_status_in_every_row():
    """AC1 exits correctly; AC2 never enters; AC3 leaves the levels, returns and exits correctly;
    AC4 leaves the levels, returns and does not exit."""
    route = SECTOR.routes[0]
    within, beyond = near_exit(route, -0.1), near_exit(route, 0.1)
    start = SECTOR.fixes[route[0]]
    followed = follow(
        *flight(
            [(*within, 300), (*beyond, 300), (*beyond, 300)],
            [(*start, 300), (*start, 300), (*start, 300)],
            [(*within, 300), (*within, 410), (*beyond, 300)],
            [(*within, 300), (*within, 190), (*within, 300)],
        )
    )
    assert [[STATUS[each] for each in row] for row in followed.status] == [
        ["in_sector", "before_entry", "in_sector", "in_sector"],
        ["exited", "before_entry", "excursion", "excursion"],
        ["exited", "before_entry", "exited", "excursion"],
    ]


def pair(distances_nm, fl=300):
    """A stationary aircraft at the origin, and one at these distances east of it."""
    return [(0.0, 0.0, 300)] * len(distances_nm), [
        (0.0, distance * NM_DEG, fl) for distance in distances_nm
    ]


def test_counts_each_loss_once():
    """From row 0 to 3 and from row 4 on; between them the distance is 20 NM for a cycle."""
    followed = follow(*flight(*pair([10, 4, 3, 20, 20, 2, 2])))
    assert followed.losses == 2
    assert followed.min_separation_nm == pytest.approx(2.0, rel=0.01)


def test_vertically_separated_aircraft_have_no_distance():
    followed = follow(*flight(*pair([10, 4, 3, 20, 20, 2, 2], fl=310)))
    assert (followed.losses, followed.min_separation_nm) == (0, np.inf)


def test_a_single_aircraft_has_no_loss():
    followed = follow(*flight(pair([10, 4])[1]))
    assert (followed.losses, followed.min_separation_nm) == (0, np.inf)


def test_aircraft_are_not_checked_after_their_exit():
    """At first, the second aircraft descends after the first has exited. Then it is level with the
    first in the cycle of the exit, which is still checked."""
    within, beyond = (near_exit(SECTOR.routes[0], part) for part in (-0.1, 0.1))
    first = [(*within, 300), (*beyond, 300), (*beyond, 300), (*beyond, 300)]
    above = [(*beyond, 320), (*beyond, 320), (*beyond, 300), (*beyond, 300)]
    followed = follow(*flight(first, above))
    assert (followed.losses, followed.min_separation_nm) == (0, np.inf)
    level = [(*beyond, 300), (*beyond, 300), (*beyond, 320), (*beyond, 300)]
    followed = follow(*flight(first, level))
    assert (followed.losses, followed.min_separation_nm) == (1, pytest.approx(0.0, abs=1e-3))


def test_the_standard_is_applied_exactly_in_float32():
    """The least float32 that is no loss, and the next smaller one, on the equator."""
    least = np.float32(SECTOR.loss_below_nm)
    for least_nm, losses in ((least, 0), (np.nextafter(least, np.float32(0.0)), 1)):
        lon = SECTOR.plane.to_degrees(np.array([least_nm, 0.0], dtype=np.float64))[1]
        followed = follow(*flight([(0.0, 0.0, 300)] * 3, [(0.0, lon, 300)] * 3))
        assert (followed.losses, followed.min_separation_nm) == (losses, least_nm)
