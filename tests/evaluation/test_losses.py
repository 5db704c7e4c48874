"""Losses of separation between hand-made paths, against the geometry of straight flight."""

import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.evaluation.losses import FlightPath, losses

SECTOR = x_plus()
"""Used near its origin, where the plane's scale is 1; standards of 5 NM and 10 flight levels."""


def path_of(east_nm, north_nm=0.0, fl=300.0):
    """A path near the origin, from its positions."""
    east_nm = np.asarray(east_nm, dtype=float)
    north, level = (np.broadcast_to(each, east_nm.shape) for each in (north_nm, fl))
    return FlightPath(np.stack([east_nm, north], axis=1), np.array(level, dtype=float))


def losses_of(*paths):
    return [tuple(loss) for loss in losses(SECTOR, paths)]


def pair(distances_nm, **other):
    """A stationary aircraft, and one at these distances north of it."""
    zeros = np.zeros(len(distances_nm))
    return path_of(zeros), path_of(zeros, np.array(distances_nm), **other)


def test_a_loss_spans_the_rows_before_and_after_it():
    """In rows 1 to 4 the distances are 6, 4, 3 and 6 NM."""
    ((first, second, begins, ends, least_nm),) = losses_of(*pair([9.0, 6.0, 4.0, 3.0, 6.0, 9.0]))
    assert (first, second, begins, ends) == (0, 1, 1, 4)
    assert least_nm == pytest.approx(3.0, abs=1e-4)


def test_losses_with_a_cycle_between_them_are_separate():
    """Each has its own minimum distance. Without a cycle between them, they are one loss."""
    apart = losses_of(*pair([6.0, 4.0, 6.0, 6.0, 2.0, 6.0, 6.0]))
    assert [loss[2:4] for loss in apart] == [(0, 2), (3, 5)]
    assert [loss[4] for loss in apart] == pytest.approx([4.0, 2.0], abs=1e-4)
    assert [loss[2:4] for loss in losses_of(*pair([6.0, 4.0, 6.0, 2.0, 6.0]))] == [(0, 4)]


@pytest.mark.parametrize(("distance_nm", "count"), [(5.0, 0), (4.999, 1), (5.001, 0)])
def test_a_distance_equal_to_the_standard_is_no_loss(distance_nm, count):
    assert len(losses_of(*pair([distance_nm] * 3))) == count


def test_the_standard_is_applied_exactly_in_float32():
    """The least float32 that is no loss, and the next smaller one, on the equator."""
    least = np.float32(SECTOR.loss_below_nm)
    for apart_nm, count in ((least, 0), (np.nextafter(least, np.float32(0.0)), 1)):
        assert len(losses_of(path_of([0.0] * 3), path_of([float(apart_nm)] * 3))) == count


@pytest.mark.parametrize(("fl", "count"), [(310.0, 0), (309.99, 1), (290.0, 0), (290.01, 1)])
def test_vertical_separation_prevents_a_loss(fl, count):
    assert len(losses_of(*pair([1.0] * 3, fl=fl))) == count


def test_finds_a_loss_between_two_rows():
    """They pass 2 NM apart, half-way between rows with distances above 10 NM."""
    east = np.array([-5.0, 5.0])
    ((*_, begins, ends, least_nm),) = losses_of(path_of(east), path_of(-east, 2.0))
    assert (begins, ends) == (0, 1)
    assert least_nm == pytest.approx(2.0, abs=1e-4)


def test_checks_every_pair():
    paths = [path_of([0.0, 0.0]), path_of([50.0, 50.0]), path_of([53.0, 53.0]), path_of([1.0, 1.0])]
    assert [(loss[:2], round(loss[4], 3)) for loss in losses_of(*paths)] == [
        ((0, 3), 1.0),
        ((1, 2), 3.0),
    ]


def test_a_path_that_has_ended_has_no_more_losses():
    """Its last position is not repeated in later rows."""
    long, short = path_of(np.zeros(400)), path_of(np.zeros(3), 2.0)
    assert [loss[:4] for loss in losses_of(long, short)] == [(0, 1, 0, 2)]
    assert [loss[:4] for loss in losses_of(short, long)] == [(0, 1, 0, 2)]
    assert losses_of(path_of([0.0]), path_of([0.0])) == []  # no cycle was flown
    assert losses_of(long) == losses_of() == []


@pytest.mark.parametrize("row", [127, 128, 129, 255, 256])
def test_misses_no_cycle_of_a_long_flight(row):
    """At the limits of blocks of cycles that are computed together."""
    distance = np.full(300, 20.0)
    distance[row] = 1.0
    assert [loss[2:4] for loss in losses_of(*pair(distance))] == [(row - 1, row + 1)]
