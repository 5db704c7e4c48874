"""The symbols of the radar pictures."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.xplus import x_plus
from skystack.reporting.radar import draw_scale_bar
from tests.sectors import FAR_NORTH


@pytest.mark.parametrize("sector", [x_plus(), FAR_NORTH], ids=lambda sector: sector.name)
@pytest.mark.parametrize("half_nm", [15.0, 60.0])
def test_scale_bar_has_its_true_length_in_the_middle_of_the_map(sector, half_nm):
    axes = plt.figure().subplots()
    axes.set(xlim=(-half_nm, half_nm), ylim=(40.0 - half_nm, 40.0 + half_nm))
    draw_scale_bar(axes, sector)
    west, east = axes.lines[0].get_xdata()
    lat, lon = sector.plane.to_degrees(np.array([[west, 40.0], [east, 40.0]])).T
    length_nm = WGS84.inv(lon[0], lat[0], lon[1], lat[1])[2] / METRES_PER_NM
    assert axes.texts[0].get_text() == f"{length_nm:.0f} NM"
    assert length_nm == pytest.approx(round(length_nm), abs=0.02)
    assert east - west <= half_nm / 2.0
    plt.close(axes.figure)
