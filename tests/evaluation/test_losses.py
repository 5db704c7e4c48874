"""Losses of separation of paths made by hand, against the geometry of straight flight."""

import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.evaluation.losses import FlightPath, losses

SECTOR = x_plus()
"""At its origin, where the scale of the plane is 1: 5 NM and 10 flight levels."""


def along(east_nm, north_nm=0.0, fl=300.0):
    """A path near the origin, from its positions to the east."""
    east_nm = np.asarray(east_nm, dtype=float)
    north, level = (np.broadcast_to(each, east_nm.shape) for each in (north_nm, fl))
    return FlightPath(np.stack([east_nm, north], axis=1), np.array(level, dtype=float))


def found(*paths):
    return [tuple(loss) for loss in losses(SECTOR, paths)]


def beside(distances_nm, **other):
    """One that stands still and one at these distances north of it."""
    zeros = np.zeros(len(distances_nm))
    return along(zeros), along(zeros, np.array(distances_nm), **other)


def test_a_loss_lasts_from_the_row_before_it_to_the_row_after_it():
    """Below 5 NM between rows 1 and 4: at 6, 4, 3 and 6 NM."""
    ((first, second, begins, ends, least_nm),) = found(*beside([9.0, 6.0, 4.0, 3.0, 6.0, 9.0]))
    assert (first, second, begins, ends) == (0, 1, 1, 4)
    assert least_nm == pytest.approx(3.0, abs=1e-4)


def test_losses_with_a_cycle_between_them_are_two():
    """Each has the least distance of its own; a loss in every cycle is one."""
    apart = found(*beside([6.0, 4.0, 6.0, 6.0, 2.0, 6.0, 6.0]))
    assert [loss[2:4] for loss in apart] == [(0, 2), (3, 5)]
    assert [loss[4] for loss in apart] == pytest.approx([4.0, 2.0], abs=1e-4)
    assert [loss[2:4] for loss in found(*beside([6.0, 4.0, 6.0, 2.0, 6.0]))] == [(0, 4)]


@pytest.mark.parametrize(("distance_nm", "lost"), [(5.0, 0), (4.999, 1), (5.001, 0)])
def test_the_standard_itself_is_no_loss(distance_nm, lost):
    assert len(found(*beside([distance_nm] * 3))) == lost


def test_a_distance_that_is_just_no_loss():
    """The least one of float32 that is none, and the one before it; on the equator."""
    least = np.float32(SECTOR.loss_below_nm)
    for apart_nm, lost in ((least, 0), (np.nextafter(least, np.float32(0.0)), 1)):
        assert len(found(along([0.0] * 3), along([float(apart_nm)] * 3))) == lost


@pytest.mark.parametrize(("fl", "lost"), [(310.0, 0), (309.99, 1), (290.0, 0), (290.01, 1)])
def test_vertical_separation_is_no_loss(fl, lost):
    assert len(found(*beside([1.0] * 3, fl=fl))) == lost


def test_what_happens_between_two_rows_counts():
    """They pass each other, 2 NM apart, half-way between rows that are 10 NM apart."""
    east = np.array([-5.0, 5.0])
    ((*_, begins, ends, least_nm),) = found(along(east), along(-east, 2.0))
    assert (begins, ends) == (0, 1)
    assert least_nm == pytest.approx(2.0, abs=1e-4)


def test_every_pair_is_checked_and_named():
    near = [along([0.0, 0.0]), along([50.0, 50.0]), along([53.0, 53.0]), along([1.0, 1.0])]
    assert [(loss[:2], round(loss[4], 3)) for loss in found(*near)] == [
        ((0, 3), 1.0),
        ((1, 2), 3.0),
    ]


def test_an_ended_path_has_no_more_losses():
    """Its last position is not kept for the rows that it does not have."""
    long, short = along(np.zeros(400)), along(np.zeros(3), 2.0)
    assert [loss[:4] for loss in found(long, short)] == [(0, 1, 0, 2)]
    assert [loss[:4] for loss in found(short, long)] == [(0, 1, 0, 2)]
    assert found(along([0.0]), along([0.0])) == []  # no cycle was flown
    assert found(long) == found() == []


@pytest.mark.parametrize("row", [127, 128, 129, 255, 256])
def test_no_cycle_is_missed_in_a_long_flight(row):
    """Whatever the number of cycles that are computed at once."""
    distance = np.full(300, 20.0)
    distance[row] = 1.0
    assert [loss[2:4] for loss in found(*beside(distance))] == [(row - 1, row + 1)]
