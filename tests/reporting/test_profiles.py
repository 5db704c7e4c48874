"""Vertical profiles: flown levels, cleared levels, clearances and exit levels over time."""

import numpy as np

from skystack.airspace.xplus import x_plus
from skystack.reporting.flights import FlownScenario, IssuedClearance, Track
from skystack.reporting.profiles import profile, profiles
from skystack.reporting.style import house_style


def climb():
    clearance = IssuedClearance(2, 12, "level", 150, "climb", 5, "AC1 climb FL150")
    track = Track(
        callsign="AC1",
        route_nm=np.zeros((0, 2)),
        position_nm=np.zeros((6, 2)),
        level_fl=np.array([100.0, 100.0, 100.0, 100.0, 102.5, 105.0]),
        cleared_fl=np.array([100.0, 100.0, 100.0, 150.0, 150.0, 150.0]),
        exit_fl=160,
        excursion_cycle=None,
        clearances=(clearance,),
    )
    return FlownScenario(x_plus(), 0, 1, (track,))


def test_draws_a_climb_as_cleared_and_flown():
    with house_style():
        axes = profile("Stacked", climb()).axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    assert axes.get_title(loc="left") == "Stacked: 1 clearance"
    assert lines["exit level"].get_ydata() == [160, 160]
    np.testing.assert_allclose(lines["level"].get_xdata(), [0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert lines["level"].get_ydata()[-1] == 105.0
    assert lines["cleared level"].get_ydata()[3] == 150.0
    assert (lines["clearance"].get_xdata(), lines["clearance"].get_ydata()) == ([0.2], [150])
    assert "climb FL150: 5 instructions" in [text.get_text() for text in axes.texts]


def test_profiles_of_one_scenario_share_their_axes():
    with house_style():
        first, second = profiles([("Plain", climb()), ("Stacked", climb())]).axes
    assert first.get_xlim() == second.get_xlim()
    assert first.get_ylim() == second.get_ylim()
