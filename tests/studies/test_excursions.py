"""Where flights make excursions."""

import math

import numpy as np
import pytest

from skystack.airspace.sectors import sector_from, sector_setting
from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.traffic_conditions import TrafficConditions
from studies.excursions import Boundary, in_words, main


@pytest.fixture(scope="module")
def sector():
    return sector_from(sector_setting("x-plus"))


def test_the_inner_corners_of_x_plus_are_between_its_arms(sector):
    """Their positions are in minutes of arc, eastwards and northwards."""
    between = [(-14.142136, 0.0), (2.988585, -11.153551), (19.318517, 5.176381)]
    between += [(10.606602, 24.748737), (-10.606602, 24.748737)]
    expected = [sector.plane.to_plane(y / 60.0, x / 60.0) for x, y in between]
    found = Boundary(sector).inner_corners_nm
    np.testing.assert_allclose(sorted(map(tuple, found)), sorted(map(tuple, expected)), atol=1e-4)


def test_distances_from_the_edge_between_two_inner_corners(sector):
    """The point is 0.005 degrees north of the middle of the edge.

    At the equator, a degree is 59.705 NM long northwards and 60.108 NM eastwards.
    """
    found = Boundary(sector).excursion(24.748737 / 60.0 + 0.005, 0.0)
    assert found.outside_nm == pytest.approx(0.005 * 59.705, abs=1e-3)
    assert found.corner_nm == pytest.approx(
        math.hypot(10.606602 / 60.0 * 60.108, found.outside_nm), abs=1e-3
    )


@pytest.mark.slow
def test_counts_the_excursions_in_a_folder(tmp_path, capsys):
    """At 450 kt, a flight is at most 0.75 NM outside at the end of the cycle in which it leaves."""
    conditions = TrafficConditions("category", cycles=200)
    result = fly_flight_school("no-op", conditions, range(2), tmp_path)
    assert main([str(result.folder)]) == 0
    printed = capsys.readouterr().out
    left = result.row["excursion_rate"] * result.row["flights_gone"]
    assert f": excursions: {left:.0f}; " in printed
    assert float(printed.split("percentile ")[1].split()[0]) < 0.75


def test_says_that_there_are_no_excursions():
    assert in_words([]) == "no flight that had entered the area made an excursion"


def test_a_folder_without_tables_is_refused_in_one_line(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "missing" in capsys.readouterr().err
